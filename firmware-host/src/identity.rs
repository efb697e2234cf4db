//! Who this robot is: the key with which it signs what it records, and what tells its runs from all others.

use std::io::{ErrorKind, Write};
use std::path::Path;

use anyhow::{Context, Result, bail};
use data_encoding::HEXLOWER;
use runtime::recording::RunIdentity;
use rustix::rand::{GetRandomFlags, getrandom};
use segment_store::private;
use segment_store::signature::RobotKey;

use crate::cli::IdentityArgs;
use crate::config::Config;

/// Linux's identity of this start of the computer.
const BOOT_ID: &str = "/proc/sys/kernel/random/boot_id";

/// `firmware-host identity`: prints the line by which a workstation knows this robot. It makes no key, because the account that
/// calls it may be another one than the robot's, which could then not read it.
///
/// # Errors
/// When the configuration names no key, or the robot has not made it yet, or it cannot be read.
pub fn run(args: &IdentityArgs) -> Result<()> {
    let config = Config::load(&args.config)?;
    let file = &config.identity.key_file;
    if file.is_empty() {
        bail!(
            "{} names no key; set identity.key_file, such as \"/var/lib/embodied-depth/identity.key\"",
            args.config.display()
        );
    }
    let key = read(Path::new(file))?.with_context(|| {
        format!("there is no identity.key_file {file} yet; the robot makes it at its first `run`")
    })?;
    println!("{} {}", key.public(), config.identity.name);
    Ok(())
}

/// The key that the configuration names, which is made if the file is missing; `None` if it names none.
///
/// # Errors
/// When the file cannot be read or made, or holds something else.
pub fn robot_key(config: &Config) -> Result<Option<RobotKey>> {
    let path = Path::new(&config.identity.key_file);
    if path.as_os_str().is_empty() {
        return Ok(None);
    }
    let key = match read(path)? {
        Some(key) => key,
        None => make(path)?,
    };
    Ok(Some(key))
}

/// The key in a file; `None` if the file is missing.
fn read(path: &Path) -> Result<Option<RobotKey>> {
    let shown = path.display();
    match std::fs::read_to_string(path) {
        Ok(text) => parse(&text).with_context(|| format!("identity.key_file {shown}")).map(Some),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error).with_context(|| {
            format!("cannot read identity.key_file {shown}; it belongs to the robot's account")
        }),
    }
}

fn parse(text: &str) -> Result<RobotKey> {
    RobotKey::parse(text.trim()).context(
        "it holds no key of 64 hexadecimal digits; move it away: the robot then makes a new key; add it to \
         the workstations' list of robots",
    )
}

/// Makes a key for this account only. The file appears with its contents or not at all, and is never replaced.
fn make(path: &Path) -> Result<RobotKey> {
    let key = RobotKey::new(&random()?);
    write_new(path, &key)
        .with_context(|| format!("cannot write identity.key_file {}", path.display()))?;
    tracing::info!("made this robot's key, {}: its identity is {}", path.display(), key.public());
    Ok(key)
}

fn write_new(path: &Path, key: &RobotKey) -> std::io::Result<()> {
    let folder = path.parent().filter(|dir| !dir.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    private::create_folder(folder)?;
    let partial = path.with_extension(format!("{}.partial", std::process::id()));
    let mut file = private::file_options().create(true).truncate(true).open(&partial)?;
    file.write_all(format!("{}\n", key.secret()).as_bytes())?;
    file.sync_all()?;
    let linked = std::fs::hard_link(&partial, path);
    std::fs::remove_file(&partial)?;
    linked?;
    std::fs::File::open(folder)?.sync_all()
}

/// The identity of a run that begins now.
///
/// # Errors
/// When the system has no random numbers.
pub fn of_run(config: &Config, key: Option<&RobotKey>) -> Result<RunIdentity> {
    let boot = std::fs::read_to_string(BOOT_ID).unwrap_or_default();
    Ok(RunIdentity {
        run: HEXLOWER.encode(&random::<16>()?),
        robot: key.map(RobotKey::public),
        name: config.identity.name.clone(),
        site: config.identity.site.clone(),
        boot: boot.trim().to_owned(),
    })
}

/// Random bytes of the kernel. At the start of a computer this waits until there are any.
fn random<const N: usize>() -> Result<[u8; N]> {
    let mut bytes = [0; N];
    let mut filled = 0;
    while filled < N {
        let rest = bytes.get_mut(filled..).unwrap_or_default();
        filled += getrandom(rest, GetRandomFlags::empty()).context("no random numbers")?;
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn config(key_file: &Path) -> Config {
        let mut config = Config::default();
        config.identity.key_file = key_file.display().to_string();
        config
    }

    #[test]
    fn a_robot_makes_its_key_at_the_first_start_and_keeps_it() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("state/identity.key");
        let first = robot_key(&config(&file)).unwrap().unwrap();
        assert_eq!(file.metadata().unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(robot_key(&config(&file)).unwrap(), Some(first.clone()));
        let other = robot_key(&config(&dir.path().join("state/other.key"))).unwrap().unwrap();
        assert_ne!(first.public(), other.public());
        assert_eq!(dir.path().join("state").read_dir().unwrap().count(), 2);
    }

    #[test]
    fn a_damaged_key_is_refused_and_never_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("identity.key");
        std::fs::write(&file, "abc\n").unwrap();
        let error = format!("{:#}", robot_key(&config(&file)).unwrap_err());
        assert!(error.contains("identity.key") && error.contains("move it away"), "{error}");
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "abc\n");
    }

    #[test]
    fn two_runs_of_one_robot_differ_and_without_a_key_a_run_has_an_identity_too() {
        let config = Config::default();
        assert_eq!(robot_key(&config).unwrap(), None);
        let first = of_run(&config, None).unwrap();
        let second = of_run(&config, None).unwrap();
        assert_eq!((first.run.len(), first.robot.as_ref()), (32, None));
        assert_ne!(first.run, second.run);
        assert_eq!(first.boot, second.boot);
    }
}
