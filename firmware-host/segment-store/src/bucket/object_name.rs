//! Names of objects that are segments: the segment's own, or that with `.age` if it is encrypted.

use std::fmt;

use crate::Name;

/// Suffix of the object of an encrypted segment, as the tool `age` gives it.
pub(super) const ENCRYPTED: &str = ".age";

/// The name of a segment's object below the prefix.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ObjectName {
    pub segment: Name,
    pub is_encrypted: bool,
}

impl ObjectName {
    /// `None` when the object is no segment.
    pub fn parse(text: &str) -> Option<Self> {
        let bare = text.strip_suffix(ENCRYPTED);
        let segment = Name::parse(bare.unwrap_or(text)).ok()?;
        Some(Self { segment, is_encrypted: bare.is_some() })
    }

    /// The name without the run.
    pub fn file(&self) -> String {
        format!("{}{}", self.segment.file(), self.suffix())
    }

    fn suffix(&self) -> &'static str {
        if self.is_encrypted { ENCRYPTED } else { "" }
    }
}

impl fmt::Display for ObjectName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.segment, self.suffix())
    }
}

/// Whether an object is a segment, or its digest or a marker beside it.
pub(super) fn is_of_segment(path: &str) -> bool {
    let beside = path.rsplit_once('.').and_then(|(object, _)| ObjectName::parse(object));
    beside.is_some() || ObjectName::parse(path).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_object_is_named_after_its_segment_and_whether_it_is_encrypted() {
        for (text, is_encrypted) in
            [("run/recording_0007.mcap", false), ("run/recording_0007.mcap.age", true)]
        {
            let name = ObjectName::parse(text).unwrap();
            assert_eq!(
                (name.segment.as_str(), name.is_encrypted),
                ("run/recording_0007.mcap", is_encrypted)
            );
            assert_eq!(name.to_string(), text);
            assert_eq!(format!("run/{}", name.file()), text);
        }
        for other in ["run/recording_0007.mcap.age.age", "run/.age", "../recording_0007.mcap.age"] {
            assert_eq!(ObjectName::parse(other), None, "{other}");
        }
    }

    #[test]
    fn what_lies_beside_a_segment_is_of_it() {
        for path in [
            "run/recording_0007.mcap.blake3",
            "run/recording_0007.mcap.age",
            "run/recording_0007.mcap.age.blake3",
            "run/recording_0007.mcap.age.pulled",
        ] {
            assert!(is_of_segment(path), "{path}");
        }
        assert!(!is_of_segment("run/summary.json.age"));
    }
}
