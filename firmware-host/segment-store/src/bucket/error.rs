//! Translation of an object store's errors into messages that tell what to do.

use std::error::Error as _;
use std::io;

use crate::StoreError;
use object_store::Error;

/// The error for an invalid URL.
pub(crate) fn bad_address(url: &str, why: &str) -> StoreError {
    let text = format!(
        "{url}: {why}; give s3://BUCKET/PREFIX, gs://BUCKET/PREFIX, az://CONTAINER/PREFIX or file:///DIR"
    );
    StoreError::Usage(text)
}

/// The cause of an error, independent of the kind of store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cause {
    NoBucket,
    NoCredentials,
    Forbidden,
    Region,
    Name,
    /// Anything else, which may succeed when retried.
    Link,
}

/// Explains an error that occurred while `doing` something (`read`, `write`, `list`, `open`) at the store at `url`.
pub(crate) fn explain(url: &str, error: &Error, doing: &str) -> StoreError {
    let words = in_one_line(error);
    let detail = match cause_of(error, &words) {
        Cause::NoBucket => {
            "there is no such bucket, container or directory; check the address and the endpoint".to_owned()
        }
        Cause::NoCredentials => format!("there are no credentials; {}", credentials(url)),
        Cause::Forbidden => format!("these credentials may not {doing} there; {}", credentials(url)),
        Cause::Region => "the bucket is in another region; set AWS_REGION".to_owned(),
        Cause::Name => {
            "an object there has a name that is not a valid file name, so nothing was pulled; remove it, or give a prefix without it"
                .to_owned()
        }
        Cause::Link => return StoreError::Link { to: url.to_owned(), source: io::Error::other(words) },
    };
    StoreError::ObjectStore { url: url.to_owned(), detail: format!("{detail} ({words})") }
}

fn cause_of(error: &Error, words: &str) -> Cause {
    match error {
        Error::NotFound { .. } => Cause::NoBucket,
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => Cause::Forbidden,
        Error::InvalidPath { .. } => Cause::Name,
        // The HTTP status of a failed listing is available only in the text.
        _ if has_any(words, &["404 Not Found", "No such file or directory"]) => Cause::NoBucket,
        // Without credentials, the library asks the cloud's metadata server, which exists only on machines of that cloud.
        _ if has_any(
            words,
            &["169.254.169.254", "metadata.google.internal", "Account must be specified"],
        ) =>
        {
            Cause::NoCredentials
        }
        _ if has_any(words, &["403 Forbidden", "401 Unauthorized"]) => Cause::Forbidden,
        _ if has_any(words, &["region"]) => Cause::Region,
        _ => Cause::Link,
    }
}

fn has_any(text: &str, any: &[&str]) -> bool {
    any.iter().any(|word| text.contains(word))
}

/// How to provide credentials for the store at `url`.
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

/// An error and its chain of causes in one line without control characters, each cause once.
fn in_one_line(error: &Error) -> String {
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
