//! The kernel's side of a video node, and the only unsafe code of this driver.
#![allow(unsafe_code)]

mod abi;
mod kernel;
mod mapping;

pub use kernel::KernelNode;
pub use mapping::Buffers;
