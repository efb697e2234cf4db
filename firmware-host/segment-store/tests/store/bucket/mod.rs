//! Pulling from and uploading to object stores.

mod encrypted;
mod fleet;
mod http;
mod pulling;
mod uploading;
