//! Pulling from and uploading to object stores.

mod fleet;
mod http;
mod pulling;
mod uploading;
