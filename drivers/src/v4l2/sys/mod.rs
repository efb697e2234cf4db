//! The kernel interface of a video node. This is the only unsafe code of the driver.
#![allow(unsafe_code)]

mod abi;
mod kernel;
mod mapping;

pub use kernel::KernelNode;
pub use mapping::Buffers;
