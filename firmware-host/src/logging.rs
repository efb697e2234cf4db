//! The log on standard error. The environment variable `RUST_LOG` selects what is logged.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

/// What is logged without `RUST_LOG`: warnings, and while a robot drives also how well its depth agrees with the LiDAR, once a
/// minute, which devices work again, and which old segments were removed.
pub const DEFAULT_FILTER: &str = "warn,firmware_host::run=info,firmware_host::record=info";

/// Starts the log.
pub fn start() {
    tracing_subscriber::fmt()
        .with_env_filter(
            EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(DEFAULT_FILTER)),
        )
        .with_writer(std::io::stderr)
        // It reports a closed standard error by `eprintln!`, which then panics: a robot must not stop for that.
        .log_internal_errors(false)
        // systemd's journal shows colour codes as garbage.
        .with_ansi(std::io::stderr().is_terminal())
        .init();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::run::log_agreement;
    use crate::setup::lidar_agreement;
    use std::sync::{Arc, Mutex};

    #[derive(Clone, Default)]
    struct Written(Arc<Mutex<Vec<u8>>>);

    impl std::io::Write for Written {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn without_rust_log_the_accuracy_of_the_depth_is_logged_and_details_are_not() {
        let written = Written::default();
        let writer = written.clone();
        let log = tracing_subscriber::fmt()
            .with_env_filter(EnvFilter::new(DEFAULT_FILTER))
            .with_writer(move || writer.clone())
            .finish();
        tracing::subscriber::with_default(log, || {
            let agreement = lidar_agreement(&Config::default());
            log_agreement(&agreement, &mut Some(0), u64::MAX);
            tracing::info!(target: "firmware_host::setup", "which library");
            tracing::warn!(target: "simulator", "which axis");
        });
        let text = String::from_utf8(written.0.lock().unwrap().clone()).unwrap();
        assert!(text.contains("the LiDAR's scan plane") && text.contains("which axis"), "{text}");
        assert!(!text.contains("which library"), "{text}");
    }
}
