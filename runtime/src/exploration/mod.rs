//! Where to go next: the policies.
