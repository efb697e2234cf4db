//! What went wrong, in one sentence.

use anyhow::Error;

/// The error and its causes, each once: many say themselves what the system said.
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
    fn a_cause_that_was_told_is_not_told_again() {
        let error = anyhow!("disk full")
            .context("cannot write a.png: disk full; make room")
            .context("no report");
        assert_eq!(sentence(&error), "no report: cannot write a.png: disk full; make room");
        assert_eq!(
            sentence(&anyhow!("disk full").context("cannot write")),
            "cannot write: disk full"
        );
        assert_eq!(sentence(&anyhow!("line 1\n  ^\n")), "line 1\n  ^");
    }
}
