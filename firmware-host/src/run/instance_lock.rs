//! One program per base: two that command the same wheels would each take them for its own.

use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener};

use anyhow::{Context, Result, bail};

/// As long as it lives, no other program on this computer takes the same base.
#[derive(Debug)]
pub struct InstanceLock {
    /// A name in the kernel's abstract namespace, and nobody connects to it: it needs no file and no right, belongs to the network
    /// namespace like CAN interfaces do, and is gone when the program is, however it ended (unix(7)).
    _name: UnixListener,
}

impl InstanceLock {
    /// Takes the base on this bus.
    ///
    /// # Errors
    /// When another program has it.
    pub fn on(bus: &str) -> Result<Self> {
        // The kernel allows 107 bytes: a long path is told apart by its digest.
        let name = format!("embodied-depth/base/{}", blake3::hash(bus.as_bytes()).to_hex());
        let address = SocketAddr::from_abstract_name(name).context("cannot name the base")?;
        match UnixListener::bind_addr(&address) {
            Ok(name) => Ok(Self { _name: name }),
            Err(error) if error.kind() == io::ErrorKind::AddrInUse => bail!(
                "another `firmware-host run` drives the base on {bus}: end it first (`firmware-host health` says which it is)"
            ),
            Err(error) => Err(error).with_context(|| {
                format!("cannot make sure that no other program drives the base on {bus}")
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::InstanceLock;

    #[test]
    fn a_base_is_taken_once_and_free_again_when_its_program_ends() {
        let bus = format!("test bus of process {}", std::process::id());
        let first = InstanceLock::on(&bus).unwrap();
        let refused = InstanceLock::on(&bus).unwrap_err().to_string();
        assert!(refused.contains(&bus) && refused.contains("end it first"), "{refused}");
        let other = InstanceLock::on(&format!("{bus}, another one"));
        assert!(other.is_ok(), "{other:?}");
        drop(first);
        InstanceLock::on(&bus).unwrap();
    }
}
