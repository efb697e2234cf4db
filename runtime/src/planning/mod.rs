//! Ways through the map, and how to drive them.
