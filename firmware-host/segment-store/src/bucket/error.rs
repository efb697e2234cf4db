//! What an object store's errors mean, and what to do about them.

use std::error::Error as _;
use std::io;

use crate::BufferError;
use object_store::Error;

/// An address that is none.
pub(crate) fn bad_address(url: &str, why: &str) -> BufferError {
    let text = format!(
        "{url}: {why}; give s3://BUCKET/PREFIX, gs://BUCKET/PREFIX, az://CONTAINER/PREFIX or file:///DIR"
    );
    BufferError::Usage(text)
}

/// What is wrong, whatever the store calls it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Trouble {
    NoBucket,
    NoCredentials,
    Forbidden,
    Region,
    Name,
    /// Anything that may pass.
    Link,
}

/// What came of `doing` something with the store at `url`.
pub(crate) fn explain(url: &str, error: &Error, doing: &str) -> BufferError {
    let words = words(error);
    let detail = match trouble(error, &words) {
        Trouble::NoBucket => {
            "there is no such bucket, container or directory; check the address and the endpoint".to_owned()
        }
        Trouble::NoCredentials => format!("there are no credentials; {}", credentials(url)),
        Trouble::Forbidden => format!("these credentials may not {doing} there; {}", credentials(url)),
        Trouble::Region => "the bucket is in another region; set AWS_REGION".to_owned(),
        Trouble::Name => {
            "an object there has a name that no file may have, so nothing was pulled; remove it, or give a prefix without it"
                .to_owned()
        }
        Trouble::Link => return BufferError::Link { to: url.to_owned(), source: io::Error::other(words) },
    };
    BufferError::Store { url: url.to_owned(), detail: format!("{detail} ({words})") }
}

fn trouble(error: &Error, words: &str) -> Trouble {
    let says = |any: &[&str]| any.iter().any(|word| words.contains(word));
    match error {
        Error::NotFound { .. } => Trouble::NoBucket,
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => Trouble::Forbidden,
        Error::InvalidPath { .. } => Trouble::Name,
        // A listing's status stands only in its words.
        _ if says(&["404 Not Found", "No such file or directory"]) => Trouble::NoBucket,
        // Where a computer of Amazon's, Google's or Azure's finds its own credentials; others ask in vain.
        _ if says(&[
            "169.254.169.254",
            "metadata.google.internal",
            "Account must be specified",
        ]) =>
        {
            Trouble::NoCredentials
        }
        _ if says(&["403 Forbidden", "401 Unauthorized"]) => Trouble::Forbidden,
        _ if says(&["region"]) => Trouble::Region,
        _ => Trouble::Link,
    }
}

/// Where they come from.
fn credentials(url: &str) -> &'static str {
    match url.split("://").next() {
        Some("s3") => {
            "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (a profile's: eval \"$(aws configure export-credentials \
             --format env)\"), or AWS_SKIP_SIGNATURE=true for a public bucket"
        }
        Some("gs") => "set GOOGLE_APPLICATION_CREDENTIALS to the file of a service account",
        Some("az") => "set AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY",
        _ => "check the permissions",
    }
}

/// An error and its causes in one line without control characters, each cause once.
fn words(error: &Error) -> String {
    let mut words = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let text = error.to_string();
        if !words.contains(&text) {
            words = format!("{words}: {text}");
        }
        cause = error.source();
    }
    words.chars().map(|c| if c.is_control() { ' ' } else { c }).take(600).collect()
}
