//! Allows one program per base: two programs must not command the same wheels.

use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener};

use anyhow::{Context, Result, bail};

/// While this lock exists, no other program on this computer can use the same base.
#[derive(Debug)]
pub struct InstanceLock {
    /// The lock is a name in the kernel's abstract socket namespace, to which no client connects. It needs no file and
    /// no permission, belongs to the network namespace as CAN interfaces do, and disappears when the program ends for
    /// any reason (unix(7)).
    _name: UnixListener,
}

impl InstanceLock {
    /// Takes the lock of the base on this bus.
    ///
    /// # Errors
    /// Another program holds the lock.
    pub fn on(bus: &str) -> Result<Self> {
        // The kernel allows 107 bytes. The digest is short and differs for every bus.
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
