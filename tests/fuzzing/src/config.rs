use firmware_host::config::Config;

/// Arbitrary bytes as a robot's configuration. A configuration that is accepted can be written, and
/// is the same when it is read again.
pub fn config(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match Config::parse(text, "robot.toml".as_ref()) {
        Err(error) => assert!(!error.to_string().is_empty()),
        Ok(config) => {
            let _ = config.check_devices("robot.toml".as_ref());
            let written = config.to_toml().expect("an accepted configuration can be written");
            assert_eq!(
                Config::parse(&written, "written".as_ref())
                    .expect("a written configuration can be read"),
                config
            );
        }
    }
}
