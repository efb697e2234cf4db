//! The keys of encrypted segments: for whom an upload encrypts, and with what a pull decrypts.
//!
//! They are those of the age format of the kind X25519, as `age-keygen` makes them.

use std::path::Path;
use std::str::FromStr;

use age::x25519::{Identity, Recipient};

use crate::StoreError;

/// A header has about 100 bytes for each recipient, and is read in one request.
const MOST_RECIPIENTS: usize = 100;

/// The beginning of a secret key.
const SECRET: &str = "AGE-SECRET-KEY-";

/// The public keys that segments are encrypted to, and the secret keys that decrypt segments. Either may be empty.
#[derive(Clone, Default)]
pub struct Keys {
    pub(super) recipients: Vec<Recipient>,
    pub(super) identities: Vec<Identity>,
}

impl Keys {
    /// Reads keys. Each of `recipients` is a public key or a file with one in each line, each of `identities` a file of secret
    /// keys.
    ///
    /// # Errors
    /// When a file cannot be read, or holds something else or no key.
    pub fn read(
        recipients: &[String],
        identities: &[impl AsRef<Path>],
    ) -> Result<Self, StoreError> {
        let mut keys = Self::default();
        for text in recipients {
            keys.recipients.extend(recipients_of(text)?);
        }
        for file in identities {
            keys.identities.extend(lines_of(file.as_ref(), bad_identity)?);
        }
        if keys.recipients.len() > MOST_RECIPIENTS {
            return Err(StoreError::Usage(format!(
                "{} recipients are too many; give at most {MOST_RECIPIENTS}",
                keys.recipients.len()
            )));
        }
        Ok(keys)
    }
}

fn recipients_of(text: &str) -> Result<Vec<Recipient>, StoreError> {
    if text.starts_with("age1") {
        let recipient = text.parse().map_err(|_| StoreError::Usage(bad_recipient(text, text)))?;
        return Ok(vec![recipient]);
    }
    if text.starts_with(SECRET) {
        return Err(StoreError::Usage(bad_recipient("--encrypt-to", text)));
    }
    lines_of(Path::new(text), bad_recipient)
}

/// The keys of a file, one in each line. Empty lines and lines that begin with `#` are ignored. `bad` explains a line that holds
/// none, and must not repeat it: it may be a secret.
fn lines_of<K: FromStr>(
    file: &Path,
    bad: impl Fn(&str, &str) -> String,
) -> Result<Vec<K>, StoreError> {
    let bytes = std::fs::read(file).map_err(|error| {
        StoreError::Usage(format!("cannot read keys from {}: {error}", file.display()))
    })?;
    let text = String::from_utf8_lossy(&bytes);
    let mut keys = Vec::new();
    for (index, line) in text.lines().map(str::trim).enumerate() {
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let place = format!("{}, line {}", file.display(), index + 1);
        keys.push(line.parse().map_err(|_| StoreError::Usage(bad(&place, line)))?);
    }
    if keys.is_empty() {
        return Err(StoreError::Usage(format!("{} holds no key", file.display())));
    }
    Ok(keys)
}

fn bad_recipient(place: &str, line: &str) -> String {
    if line.starts_with(SECRET) {
        return format!(
            "{place}: this is a secret key, which decrypts; give its public key, which `age-keygen -y FILE` prints"
        );
    }
    format!(
        "{place}: this is no public key of age of the kind X25519; give age1... or a file with one in each line, as `age-keygen` prints them"
    )
}

fn bad_identity(place: &str, line: &str) -> String {
    if line.starts_with("age-encryption.org/") || line.starts_with("-----BEGIN AGE") {
        return format!(
            "{place}: the file is itself encrypted; decrypt it first (`age -d FILE > key.txt`)"
        );
    }
    format!(
        "{place}: this is no secret key of age of the kind X25519; give a file that `age-keygen -o FILE` wrote"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    // The pair of the age crate's own tests.
    const IDENTITY: &str =
        "AGE-SECRET-KEY-1GQ9778VQXMMJVE8SK7J6VT8UJ4HDQAJUVSFCWCM02D8GEWQ72PVQ2Y5J33";
    const RECIPIENT: &str = "age1t7rxyev2z3rw82stdlrrepyc39nvn86l5078zqkf5uasdy86jp6svpy7pa";

    fn file(text: &str) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        file
    }

    fn read(recipients: &[&str], identities: &[&Path]) -> Result<Keys, String> {
        let recipients: Vec<String> = recipients.iter().map(|text| (*text).to_owned()).collect();
        Keys::read(&recipients, identities).map_err(|error| error.to_string())
    }

    #[test]
    fn recipients_are_given_by_themselves_and_in_files() {
        let two = file(&format!("# ours\n{RECIPIENT}\n\n  {RECIPIENT}\r\n"));
        let keys = read(&[RECIPIENT, two.path().to_str().unwrap()], &[]).unwrap();
        assert_eq!(keys.recipients.len(), 3);
        assert!(keys.recipients.iter().all(|recipient| recipient.to_string() == RECIPIENT));
    }

    #[test]
    fn a_file_of_age_keygen_is_an_identity() {
        let key = file(&format!("# created: 2026-12-01\n# public key: {RECIPIENT}\n{IDENTITY}\n"));
        let keys = read(&[], &[key.path()]).unwrap();
        assert_eq!(keys.identities[0].to_public().to_string(), RECIPIENT);
    }

    #[test]
    fn a_secret_key_in_the_place_of_a_public_one_is_refused_and_not_shown() {
        let key = file(&format!("# a key\n{IDENTITY}\n"));
        for given in [key.path().to_str().unwrap(), IDENTITY] {
            let error = read(&[given], &[]).err().unwrap();
            assert!(error.contains("age-keygen -y") && !error.contains(IDENTITY), "{error}");
        }
    }

    #[test]
    fn what_is_no_key_is_refused_with_its_place_and_the_way_out() {
        let wrong = RECIPIENT.replace("t7r", "t7t");
        assert!(read(&[&wrong], &[]).err().unwrap().contains(&wrong));
        let other = file(&format!("{RECIPIENT}\nage1yubikey1abc\n"));
        let path = other.path().to_str().unwrap();
        let error = read(&[path], &[]).err().unwrap();
        assert!(error.contains("line 2") && error.contains("X25519"), "{error}");
        let error = read(&[], &[other.path()]).err().unwrap();
        assert!(error.contains("line 1") && error.contains("age-keygen -o"), "{error}");
        let protected = file("age-encryption.org/v1\n-> scrypt x 18\n");
        assert!(read(&[], &[protected.path()]).err().unwrap().contains("age -d"));
        let empty = file("# nothing\n");
        assert!(read(&[], &[empty.path()]).err().unwrap().contains("holds no key"));
        assert!(read(&["no/such/file"], &[]).err().unwrap().contains("no/such/file"));
        let many = file(&format!("{RECIPIENT}\n").repeat(101));
        let error = read(&[many.path().to_str().unwrap()], &[]).err().unwrap();
        assert!(error.contains("101 recipients"), "{error}");
    }
}
