//! The driver against a folder of files in place of sysfs, and a FIFO in place of the character device.

mod driving;
mod fake;
mod setting_up;
