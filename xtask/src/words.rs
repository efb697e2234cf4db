//! A test that finds words which users and engineers do not understand at first reading: private terms, and pronouns in place of
//! an actor.

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use crate::paths;

    /// Words that are not allowed in the string literals and the command-line help of programs, and in documents.
    const BANNED: [&str; 23] = [
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
    ];

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

    /// The string literals of a line of code outside comments, without names in braces and without keys and options, which are
    /// formats. Good enough for lines as rustfmt leaves them.
    fn literals(line: &str) -> String {
        let code = line.trim_start();
        if code.starts_with("//") && !code.starts_with("///") {
            return String::new();
        }
        let texts = line.split('"').skip(1).step_by(2).filter(|text| text.contains(' '));
        let spoken = texts.map(|text| {
            let parts =
                text.split('{').map(|part| part.split_once('}').map_or(part, |(_, rest)| rest));
            parts.collect::<String>()
        });
        spoken.collect::<Vec<_>>().join(" ").to_lowercase()
    }

    /// The literals of a line, or all of it if it is documentation, of which clap makes help.
    fn spoken_with_help(line: &str) -> String {
        let help = line.trim_start().strip_prefix("///").map(str::to_lowercase);
        help.unwrap_or_else(|| literals(line))
    }

    #[test]
    fn messages_help_and_documents_are_free_of_banned_words() {
        let root = paths::root();
        let mut found = Vec::new();
        let mut sources = Vec::new();
        for folder in ["firmware-host", "drivers", "runtime", "tools", "xtask"] {
            files(&root.join(folder), ".rs", &mut sources);
        }
        for path in sources.iter().filter(|path| !path.ends_with("words.rs")) {
            let text = std::fs::read_to_string(path).unwrap();
            let code = text.split("#[cfg(test)]").next().unwrap_or_default();
            let has_help = code.contains("use clap");
            for (number, line) in code.lines().enumerate() {
                let line = if has_help { spoken_with_help(line) } else { literals(line) };
                found.extend(banned(&line).map(|word| (path.clone(), number + 1, word)));
            }
        }
        let mut documents = Vec::new();
        files(&root.join("docs"), ".md", &mut documents);
        documents.extend(["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"].map(|f| root.join(f)));
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
            let apart = |c: Option<char>| c.is_none_or(|c| !c.is_alphanumeric() && c != '_');
            apart(before) && apart(after)
        })
    }

    #[test]
    fn a_word_is_found_whole_and_in_strings_and_help_only() {
        assert!(has_word("nobody is there", "nobody") && !has_word("somenobodys", "nobody"));
        assert_eq!(literals(r#"let x = f("a b"); // "c""#).trim(), "a b");
        assert_eq!(literals(r#"    // "nobody is here""#), "");
        assert_eq!(spoken_with_help("    /// Nobody is here."), " nobody is here.");
        assert_eq!(spoken_with_help("    // Nobody is here."), "");
        assert_eq!(
            literals(r#"f("pictures", "--pictures", "of {pictures} frames")"#),
            "of  frames"
        );
    }
}
