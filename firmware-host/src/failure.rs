//! Formats an error and its causes as one line.

use anyhow::Error;

/// The error and its causes, separated by colons. A cause that the text already contains is left
/// out, because many of our errors quote the operating system's message themselves.
#[must_use]
pub fn sentence(error: &Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let words = cause.to_string();
        let words = words.trim_end();
        if !text.contains(words) {
            let separator = if text.is_empty() { "" } else { ": " };
            text = format!("{text}{separator}{words}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::anyhow;

    #[test]
    fn a_cause_that_the_message_already_contains_is_not_repeated() {
        let error = anyhow!("disk full")
            .context("cannot write a.png: disk full; free some space")
            .context("no report");
        assert_eq!(sentence(&error), "no report: cannot write a.png: disk full; free some space");
        assert_eq!(
            sentence(&anyhow!("disk full").context("cannot write")),
            "cannot write: disk full"
        );
        assert_eq!(sentence(&anyhow!("line 1\n  ^\n")), "line 1\n  ^");
    }
}
