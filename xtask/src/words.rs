//! A test that finds words which users and engineers do not understand at first reading: private terms, and pronouns in place of
//! an actor.

#[cfg(test)]
mod source;

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use super::source;
    use crate::paths;

    /// Words that are not allowed in the string literals and the command-line help of programs, in documents, and in the live
    /// view's page.
    const BANNED: [&str; 26] = [
        "nobody",
        "somebody",
        "anybody",
        "whoever",
        "whom",
        "by dice",
        "not well",
        "so many",
        "the wish",
        "wishes",
        "is told",
        "told to",
        "told by",
        "the mind",
        "hears",
        "makes room",
        "make room",
        "no room",
        "takes up",
        "turn of the loop",
        "this turn",
        "pictures",
        "while away",
        "by itself",
        "is void",
        "as it was told",
    ];

    /// Folders with Rust source whose texts users read.
    const PROGRAMS: [&str; 7] =
        ["firmware-host", "drivers", "runtime", "hal", "tools", "xtask", "tests/src"];

    fn files(folder: &Path, extension: &str, found: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                if !matches!(name.as_str(), "target" | "tests" | ".git" | ".venv") {
                    files(&path, extension, found);
                }
            } else if name.ends_with(extension) && !name.ends_with("tests.rs") {
                found.push(path);
            }
        }
    }

    #[test]
    fn messages_help_and_documents_are_free_of_banned_words() {
        let root = paths::root();
        let mut sources = Vec::new();
        for folder in PROGRAMS {
            files(&root.join(folder), ".rs", &mut sources);
        }
        let mut documents =
            ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"].map(|f| root.join(f)).to_vec();
        let web = root.join("firmware-host/live-view/web");
        for (folder, extension) in [(&root.join("docs"), ".md"), (&web, ".js"), (&web, ".html")] {
            files(folder, extension, &mut documents);
        }
        let mut found = Vec::new();
        for path in sources {
            let source = std::fs::read_to_string(&path).unwrap();
            for (line, text) in source::texts(&source, source.contains("use clap")) {
                found.extend(banned(&text).map(|word| (path.clone(), line, word)));
            }
        }
        for path in documents {
            let text = std::fs::read_to_string(&path).unwrap().to_lowercase();
            for (number, line) in text.lines().enumerate() {
                found.extend(banned(line).map(|word| (path.clone(), number + 1, word)));
            }
        }
        assert!(found.is_empty(), "{found:#?}");
    }

    fn banned(line: &str) -> impl Iterator<Item = &'static str> {
        let words: Vec<&str> = BANNED.into_iter().filter(|word| has_word(line, word)).collect();
        words.into_iter()
    }

    fn has_word(line: &str, word: &str) -> bool {
        line.match_indices(word).any(|(at, _)| {
            let before = line[..at].chars().next_back();
            let after = line[at + word.len()..].chars().next();
            [before, after]
                .into_iter()
                .flatten()
                .all(|beside| !beside.is_alphanumeric() && beside != '_')
        })
    }

    #[test]
    fn a_word_is_found_whole() {
        assert!(has_word("nobody is there", "nobody") && !has_word("somenobodys", "nobody"));
        assert!(has_word("\"it is void: {}\"", "is void") && !has_word("avoid", "void"));
    }
}
