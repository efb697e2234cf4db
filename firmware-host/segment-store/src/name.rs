//! Names of segments in a store. Every name that another computer sends is checked here before it is used as a path.

use std::cmp::Ordering;
use std::fmt;

/// Longest name of a directory or file. File systems allow 255 bytes, and suffixes are appended to these names.
const MAX_PART: usize = 128;

/// The error for a name that does not denote a segment.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{shown:?} is not the name of a segment; segments are called [RUN/]recording_NNNN.mcap")]
pub struct BadName {
    shown: String,
}

/// The name of a segment, `[RUN/]recording_NNNN.mcap`: a relative path without `..` and without hidden parts. Names sort by
/// run, then in the order of recording.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Name {
    text: String,
}

impl Name {
    /// # Errors
    /// [`BadName`] when `text` does not have that form.
    pub fn parse(text: &str) -> Result<Self, BadName> {
        let (run, file) =
            text.rsplit_once('/').map_or((None, text), |(run, file)| (Some(run), file));
        if run.is_none_or(is_part) && is_part(file) && is_segment_name(file) {
            Ok(Self { text: text.to_owned() })
        } else {
            Err(BadName { shown: text.chars().take(200).collect() })
        }
    }

    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.text
    }

    /// The directory of the run; empty when the store is the directory of one run.
    #[must_use]
    pub fn run(&self) -> &str {
        self.text.rsplit_once('/').map_or("", |(run, _)| run)
    }

    /// The file name without the run.
    #[must_use]
    pub fn file(&self) -> &str {
        self.text.rsplit_once('/').map_or(&self.text, |(_, file)| file)
    }

    /// The number of the segment in its run: 7 for `recording_0007.mcap`.
    #[must_use]
    pub fn number(&self) -> Option<u32> {
        digits(self.file())?.parse().ok()
    }

    fn order(&self) -> (&str, usize, &str) {
        // Compared by length first, so that segment 10000 sorts after segment 9999.
        (self.run(), self.file().len(), &self.text)
    }
}

impl Ord for Name {
    fn cmp(&self, other: &Self) -> Ordering {
        self.order().cmp(&other.order())
    }
}

impl PartialOrd for Name {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// Whether a file name has the form `recording_NNNN.mcap`, with at least four digits.
#[must_use]
pub fn is_segment_name(name: &str) -> bool {
    digits(name)
        .is_some_and(|digits| digits.len() >= 4 && digits.bytes().all(|byte| byte.is_ascii_digit()))
}

/// What stands in the place of a segment's number.
fn digits(name: &str) -> Option<&str> {
    name.strip_prefix("recording_")?.strip_suffix(".mcap")
}

fn is_part(part: &str) -> bool {
    !part.is_empty()
        && part.len() <= MAX_PART
        && !part.starts_with('.')
        && !part.chars().any(|c| c == '/' || c == '\\' || c.is_control())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_segment_is_named_with_or_without_its_run() {
        for (text, run, file) in [
            ("recording_0000.mcap", "", "recording_0000.mcap"),
            ("monday 3/recording_12345.mcap", "monday 3", "recording_12345.mcap"),
        ] {
            let name = Name::parse(text).unwrap();
            assert_eq!((name.run(), name.file(), name.as_str()), (run, file, text));
            assert!(matches!(name.number(), Some(0 | 12345)));
        }
    }

    #[test]
    fn a_name_that_could_lead_out_of_the_store_is_refused() {
        for bad in [
            "",
            "/",
            "..",
            "../recording_0000.mcap",
            "/recording_0000.mcap",
            "/etc/passwd",
            "run/../recording_0000.mcap",
            "./recording_0000.mcap",
            "run//recording_0000.mcap",
            "a/b/recording_0000.mcap",
            "a/b/c/recording_0000.mcap",
            ".ssh/recording_0000.mcap",
            "run/recording_0000.mcap/",
            "run\\recording_0000.mcap/x",
            "run/id_rsa",
            "recording_0000.mcap.pulled",
            "a\0/recording_0000.mcap",
            "a\n/recording_0000.mcap",
            "recording_00x0.mcap",
            "run/notes.json",
            "run/clips/../recording_0000.mcap",
            "run/clips/07.mcap",
        ] {
            assert!(Name::parse(bad).is_err(), "{bad:?}");
        }
        assert!(Name::parse(&format!("{}/recording_0000.mcap", "r".repeat(129))).is_err());
    }

    #[test]
    fn names_sort_in_the_order_of_recording() {
        let mut names: Vec<Name> =
            ["b/recording_0000.mcap", "a/recording_10000.mcap", "a/recording_9999.mcap"]
                .map(|text| Name::parse(text).unwrap())
                .into();
        names.sort();
        let texts: Vec<&str> = names.iter().map(Name::as_str).collect();
        assert_eq!(
            texts,
            ["a/recording_9999.mcap", "a/recording_10000.mcap", "b/recording_0000.mcap"]
        );
    }

    proptest! {
        #[test]
        fn an_accepted_name_stays_below_the_directory_that_it_is_joined_to(text in "[./a\\\\~]{0,6}(/|run|recording_0001.mcap|\\.\\.|\0)*") {
            if let Ok(name) = Name::parse(&text) {
                let path = std::path::Path::new(name.as_str());
                prop_assert!(path.components().all(|part| matches!(part, std::path::Component::Normal(_))));
                prop_assert!(path.components().count() <= 2);
            }
        }
    }
}
