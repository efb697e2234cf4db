//! A test that finds words which users and engineers do not understand at first reading: private terms, and pronouns in place of
//! an actor.

#[cfg(test)]
mod source;

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use super::source;
    use crate::{command, paths};

    /// Words that are not allowed in the string literals and the command-line help of Rust programs, nor anywhere in the files
    /// that `TEXTS` names.
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

    /// Files of which every line is read, as git names them: documents, Python with its comments, the package, and the live
    /// view's page.
    const TEXTS: [&str; 7] = [
        "*.md",
        "*.py",
        "firmware-host/packaging",
        "firmware-host/live-view/web/*.js",
        "firmware-host/live-view/web/*.html",
        // The texts of licences are those of their authors.
        ":!firmware-host/packaging/copyright",
        // It counts such words.
        ":!tools/words/count.py",
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

    #[test]
    fn messages_help_documents_and_scripts_are_free_of_banned_words() {
        let root = paths::root();
        let mut sources = Vec::new();
        for folder in PROGRAMS {
            files(&root.join(folder), ".rs", &mut sources);
        }
        let mut found = Vec::new();
        for path in sources {
            let source = std::fs::read_to_string(&path).unwrap();
            for (line, text) in source::texts(&source, source.contains("use clap")) {
                found.extend(banned(&text).map(|word| (path.clone(), line, word)));
            }
        }
        for path in texts() {
            let is_markdown = path.extension().is_some_and(|extension| extension == "md");
            let text = std::fs::read_to_string(&path).unwrap().to_lowercase();
            for (number, line) in text.lines().enumerate() {
                let line = if is_markdown { without_code(line) } else { line.to_owned() };
                found.extend(banned(&line).map(|word| (path.clone(), number + 1, word)));
            }
        }
        assert!(found.is_empty(), "{found:#?}");
    }

    /// The files that `TEXTS` names, also those that are not committed yet.
    fn texts() -> Vec<PathBuf> {
        let list = ["ls-files", "--cached", "--others", "--exclude-standard", "--"];
        let listed = command::output(command::program("git").args(list).args(TEXTS)).unwrap();
        let paths = listed.lines().map(|name| paths::root().join(name));
        // Git also lists a file that was removed and whose removal is not committed yet.
        paths.filter(|path| path.exists()).collect()
    }

    /// A line of a document without what is in backticks: names of keys and options, and messages that are cited.
    fn without_code(line: &str) -> String {
        line.split('`').step_by(2).collect()
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
    fn code_in_a_document_is_left_out() {
        assert_eq!(without_code("`recording.pictures` is `recording.images`."), " is .");
        assert_eq!(without_code("A sentence without names."), "A sentence without names.");
    }

    #[test]
    fn a_word_is_found_whole() {
        assert!(has_word("nobody is there", "nobody") && !has_word("somenobodys", "nobody"));
        assert!(has_word("\"it is void: {}\"", "is void") && !has_word("avoid", "void"));
    }
}
