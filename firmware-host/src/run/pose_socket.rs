//! Poses from another program, as datagrams on a Unix socket: one JSON object each, as [`OutsidePose`] describes it.

use std::fs::Permissions;
use std::io::ErrorKind;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use runtime::outside_pose::OutsidePose;

/// Longer datagrams are no pose.
const LONGEST: usize = 512;
/// Datagrams that are read before one tick. The kernel keeps the rest; a sender at 1 kHz sends 100.
const MOST: usize = 256;

/// The socket of a running robot. Its file is removed at the end.
#[derive(Debug)]
pub struct PoseSocket {
    socket: UnixDatagram,
    path: PathBuf,
    refused: u64,
}

impl PoseSocket {
    /// Listens at `path`; `None` for an empty path. Only the robot's user and group may send.
    ///
    /// # Errors
    /// When the socket cannot be made there, or a file is there that is no socket.
    pub fn open(path: &str) -> Result<Option<Self>> {
        if path.is_empty() {
            return Ok(None);
        }
        let path = PathBuf::from(path);
        let socket = bind(&path)
            .with_context(|| format!("run.pose_socket: cannot listen at {}", path.display()))?;
        Ok(Some(Self { socket, path, refused: 0 }))
    }

    /// The newest pose that has come since the last call. A datagram that is no pose is counted, and the first one is logged.
    pub fn take(&mut self) -> Option<OutsidePose> {
        let mut newest = None;
        let mut bytes = [0; LONGEST];
        for _ in 0..MOST {
            match self.socket.recv(&mut bytes) {
                Ok(length) => match serde_json::from_slice(bytes.get(..length)?) {
                    Ok(pose) => newest = Some(pose),
                    Err(error) => self.refuse(&error),
                },
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => break,
            }
        }
        newest
    }

    fn refuse(&mut self, error: &serde_json::Error) {
        self.refused += 1;
        if self.refused == 1 {
            tracing::warn!(
                "{}: a datagram is no pose ({error}); expected {{\"time_ns\": 81250000000, \"x_m\": 1.25, \"y_m\": -0.4, \"yaw_rad\": 1.57}}",
                self.path.display()
            );
        }
    }
}

impl Drop for PoseSocket {
    fn drop(&mut self) {
        if self.refused > 1 {
            tracing::warn!("{}: {} datagrams were no poses", self.path.display(), self.refused);
        }
        let _ = std::fs::remove_file(&self.path);
    }
}

fn bind(path: &Path) -> Result<UnixDatagram> {
    match std::fs::symlink_metadata(path) {
        // A run that was killed leaves its socket behind. The lock on the bus says that no other run is alive.
        Ok(there) if there.file_type().is_socket() => std::fs::remove_file(path)?,
        Ok(_) => bail!("a file that is no socket is there; remove it or choose another path"),
        Err(_) => {}
    }
    let socket = UnixDatagram::bind(path)?;
    std::fs::set_permissions(path, Permissions::from_mode(0o660))?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::Pose2;

    fn open() -> (tempfile::TempDir, PoseSocket, UnixDatagram) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pose.sock");
        let socket = PoseSocket::open(path.to_str().unwrap()).unwrap().unwrap();
        let sender = UnixDatagram::unbound().unwrap();
        sender.connect(&path).unwrap();
        (folder, socket, sender)
    }

    #[test]
    fn the_newest_pose_counts_and_is_taken_once() {
        let (_folder, mut socket, sender) = open();
        assert_eq!(socket.take(), None);
        for (time_ns, x_m) in [(1, 0.5), (2, 0.75)] {
            let text = format!(r#"{{"time_ns":{time_ns},"x_m":{x_m},"y_m":-1,"yaw_rad":2e0}}"#);
            sender.send(text.as_bytes()).unwrap();
        }
        let pose = Pose2 { x_m: 0.75, y_m: -1.0, yaw_rad: 2.0 };
        assert_eq!(socket.take(), Some(OutsidePose { time_ns: 2, pose }));
        assert_eq!(socket.take(), None);
    }

    #[test]
    fn what_is_no_pose_is_counted_and_hides_no_pose() {
        let (_folder, mut socket, sender) = open();
        let good = r#"{"time_ns":1,"x_m":0,"y_m":0,"yaw_rad":0}"#;
        let huge = format!(r#"{{"time_ns":1,"x_m":0,"y_m":0,"yaw_rad":0.{}}}"#, "0".repeat(600));
        let bad = [
            "",
            "NaN",
            "[]",
            r#"{"time_ns":1,"x_m":NaN,"y_m":0,"yaw_rad":0}"#,
            r#"{"time_ns":-1,"x_m":0,"y_m":0,"yaw_rad":0}"#,
            r#"{"time_ns":1,"x_m":0,"y_m":0}"#,
            r#"{"time_ns":1,"x_m":0,"y_m":0,"yaw_rad":0,"z_m":0}"#,
            &huge,
        ];
        sender.send(good.as_bytes()).unwrap();
        for text in bad {
            sender.send(text.as_bytes()).unwrap();
        }
        assert_eq!(socket.take().unwrap().time_ns, 1);
        assert_eq!(socket.refused, bad.len() as u64);
    }

    #[test]
    fn only_the_robots_user_and_group_may_send_poses() {
        let (folder, _socket, _sender) = open();
        let file = std::fs::metadata(folder.path().join("pose.sock")).unwrap();
        assert_eq!(file.permissions().mode() & 0o777, 0o660);
    }

    #[test]
    fn a_socket_that_was_left_behind_is_replaced_and_another_file_is_not_touched() {
        let (folder, socket, _sender) = open();
        let path = folder.path().join("pose.sock");
        // As after a kill: the file stays.
        std::mem::forget(socket);
        drop(PoseSocket::open(path.to_str().unwrap()).unwrap());
        assert!(!path.exists(), "it is removed at the end");
        std::fs::write(&path, "mine").unwrap();
        let error = format!("{:#}", PoseSocket::open(path.to_str().unwrap()).unwrap_err());
        assert!(error.contains("run.pose_socket") && error.contains("no socket"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"mine");
        assert!(PoseSocket::open("").unwrap().is_none());
    }
}
