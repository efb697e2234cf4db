//! The recording: every input and every decision, in MCAP.
