//! A test that the example diffs of CONTRIBUTING.md can be applied to the source of today.

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use crate::paths;

    /// Lines that follow each other in a file, and what replaces them.
    #[derive(Debug, Default)]
    struct Hunk<'a> {
        file: &'a str,
        /// A piece of a line above, such as the head of the function; may be empty.
        heading: &'a str,
        old: Vec<&'a str>,
        new: Vec<&'a str>,
    }

    /// At the end of a line, this stands for the rest of the line.
    const REST: &str = " ...";

    /// The diffs of a document, each with its hunks in order. Instead of line numbers a hunk has a heading, because numbers
    /// would be wrong after every change of the file.
    fn diffs(document: &str) -> Vec<Vec<Hunk<'_>>> {
        let blocks = document.split("```diff\n").skip(1);
        blocks.filter_map(|rest| rest.split("```").next()).map(hunks).collect()
    }

    fn hunks(block: &str) -> Vec<Hunk<'_>> {
        let mut file = "";
        let mut hunks: Vec<Hunk<'_>> = Vec::new();
        for line in block.lines() {
            if let Some(path) = line.strip_prefix("--- a/") {
                file = path;
            } else if let Some(path) = line.strip_prefix("+++ b/") {
                assert_eq!(file, path, "a file is not renamed here");
            } else if let Some(heading) = line.strip_prefix("@@") {
                hunks.push(Hunk { file, heading: heading.trim(), ..Hunk::default() });
            } else {
                let hunk = hunks.last_mut().expect("a line before the first @@");
                let (sign, text) = line.split_at(1);
                if sign != "+" {
                    hunk.old.push(text);
                }
                if sign != "-" {
                    hunk.new.push(text);
                }
                assert!([" ", "-", "+"].contains(&sign), "{line}");
            }
        }
        hunks
    }

    /// The changed files of a diff. Each hunk is searched below its heading and below the hunk before it.
    ///
    /// # Errors
    /// Names the hunk that the file does not have there.
    fn applied(
        hunks: &[Hunk<'_>],
        read: impl Fn(&str) -> String,
    ) -> Result<BTreeMap<String, Vec<String>>, String> {
        let mut files = BTreeMap::new();
        for hunk in hunks {
            let (lines, searched) = files.entry(hunk.file.to_owned()).or_insert_with(|| {
                (read(hunk.file).lines().map(str::to_owned).collect::<Vec<_>>(), 0)
            });
            let Some(below) =
                lines[*searched..].iter().position(|line| line.contains(hunk.heading))
            else {
                return Err(format!("{}: no line with the heading of {hunk:?}", hunk.file));
            };
            let start = *searched + below;
            let found = lines[start..].windows(hunk.old.len().max(1)).position(|window| {
                window.iter().zip(&hunk.old).all(|(line, old)| is_meant(line, old))
            });
            let (Some(found), false) = (found, hunk.old.is_empty()) else {
                return Err(format!("{}: no lines of {hunk:?}", hunk.file));
            };
            let at = start + found;
            let last = lines[at + hunk.old.len() - 1].clone();
            let rest = hunk.old.last().and_then(|old| last.strip_prefix(old.strip_suffix(REST)?));
            let new = hunk.new.iter().map(|new| match (new.strip_suffix(REST), rest) {
                (Some(begin), Some(rest)) => format!("{begin}{rest}"),
                _ => (*new).to_owned(),
            });
            let new: Vec<String> = new.collect();
            *searched = at + new.len();
            lines.splice(at..at + hunk.old.len(), new);
        }
        Ok(files.into_iter().map(|(file, (lines, _))| (file, lines)).collect())
    }

    fn is_meant(line: &str, old: &str) -> bool {
        old.strip_suffix(REST).map_or(line == old, |begin| line.starts_with(begin))
    }

    fn source_of_today(file: &str) -> String {
        let text = std::fs::read_to_string(paths::root().join(file));
        text.unwrap_or_else(|error| panic!("{file}: {error}"))
    }

    #[test]
    fn the_example_diffs_can_be_applied_to_the_source_of_today() {
        let path = paths::root().join("CONTRIBUTING.md");
        let document = std::fs::read_to_string(path).unwrap();
        let diffs = diffs(&document);
        assert_eq!(diffs.len(), 4, "a key, a motor protocol, a LiDAR and a depth source");
        for hunks in &diffs {
            let changed = applied(hunks, source_of_today).unwrap_or_else(|error| panic!("{error}"));
            for hunk in hunks {
                let lines = &changed[hunk.file];
                assert!(hunk.new.iter().all(|new| lines.iter().any(|line| is_meant(line, new))));
            }
        }
    }

    const SOURCE: &str = "fn a() {\n    one();\n}\nfn b() {\n    one();\n    two(1, 2);\n}\n";

    fn changed(diff: &str) -> Result<String, String> {
        let document = format!("```diff\n--- a/x.rs\n+++ b/x.rs\n{diff}```\n");
        let hunks = diffs(&document).remove(0);
        applied(&hunks, |_| SOURCE.to_owned()).map(|files| files["x.rs"].join("\n") + "\n")
    }

    #[test]
    fn a_hunk_changes_the_lines_below_its_heading() {
        let second = changed("@@ fn b()\n-    one();\n+    three();\n").unwrap();
        assert_eq!(second, SOURCE.replace("one();\n    two", "three();\n    two"));
        let first = changed("@@\n     one();\n+    three();\n").unwrap();
        assert_eq!(first, SOURCE.replacen("one();", "one();\n    three();", 1));
        let rest = changed("@@\n-    two(1, ...\n+    two(0, 1, ...\n").unwrap();
        assert_eq!(rest, SOURCE.replace("two(1, 2)", "two(0, 1, 2)"));
    }

    #[test]
    fn a_stale_diff_is_refused() {
        for diff in [
            "@@\n     zero();\n+    three();\n",
            "@@ fn c()\n     one();\n+    three();\n",
            "@@\n+fn c() {}\n",
            // The lines do not follow each other.
            "@@\n     one();\n+    three();\n }\n fn a() {\n",
            // The order is another one.
            "@@\n     two(1, 2);\n+    three();\n@@ fn a()\n     one();\n+    three();\n",
        ] {
            assert!(changed(diff).is_err(), "{diff}");
        }
    }
}
