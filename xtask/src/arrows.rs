//! A test that the crates depend on each other as ARCHITECTURE.md says, one way only.

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use crate::{command, paths};

    /// The heading of the table in ARCHITECTURE.md. Its rows are `crate | uses`.
    const HEADING: &str = "## Arrows between crates\n";
    /// Behind a dependency that only a feature brings.
    const OPTIONAL: &str = " (optional)";

    /// A crate and the crates of this workspace that it uses, by name.
    type Row = (String, Vec<String>);

    /// What the manifests say. Dependencies of tests alone do not count, because no program contains them.
    fn actual() -> Vec<Row> {
        let arguments = ["metadata", "--no-deps", "--format-version", "1", "--offline"];
        let metadata = command::output(command::cargo().args(arguments)).unwrap();
        let metadata: Value = serde_json::from_str(&metadata).unwrap();
        let packages = metadata["packages"].as_array().unwrap();
        let ours: Vec<&str> = packages.iter().map(|package| text(&package["name"])).collect();
        let rows = packages.iter().map(|package| {
            let all = package["dependencies"].as_array().unwrap().iter();
            let counted = all.filter(|dependency| {
                dependency["kind"] != "dev" && ours.contains(&text(&dependency["name"]))
            });
            let uses = counted.map(|dependency| {
                let suffix = if dependency["optional"] == true { OPTIONAL } else { "" };
                format!("{}{suffix}", text(&dependency["name"]))
            });
            sorted(text(&package["name"]).to_owned(), uses.collect())
        });
        rows.collect()
    }

    /// What ARCHITECTURE.md says, in its order.
    fn documented(architecture: &str) -> Vec<Row> {
        let (_, section) = architecture.split_once(HEADING).unwrap();
        let section = section.split("\n## ").next().unwrap();
        let lines = section.lines().filter_map(|line| line.strip_prefix("| `"));
        let rows = lines.map(|line| {
            let (name, uses) = line.trim_end_matches('|').split_once("` |").unwrap();
            let uses = uses.split(',').map(|used| used.trim().replace('`', ""));
            sorted(name.to_owned(), uses.filter(|used| !used.is_empty()).collect())
        });
        rows.collect()
    }

    fn text(value: &Value) -> &str {
        value.as_str().unwrap()
    }

    fn sorted(name: String, mut uses: Vec<String>) -> Row {
        uses.sort();
        uses.dedup();
        (name, uses)
    }

    /// The dependencies that do not lead to a row above.
    fn wrong_way(rows: &[Row]) -> Vec<String> {
        let mut wrong = Vec::new();
        for (index, (name, uses)) in rows.iter().enumerate() {
            let above = &rows[..index];
            for used in uses.iter().map(|used| used.trim_end_matches(OPTIONAL)) {
                if !above.iter().any(|(above, _)| above == used) {
                    wrong.push(format!("{name} uses {used}, which is not above it"));
                }
            }
        }
        wrong
    }

    #[test]
    fn the_crates_depend_on_each_other_as_the_architecture_says() {
        let path = paths::root().join("ARCHITECTURE.md");
        let documented = documented(&std::fs::read_to_string(path).unwrap());
        let mut actual = actual();
        actual.sort();
        let mut in_order = documented.clone();
        in_order.sort();
        assert_eq!(actual, in_order, "ARCHITECTURE.md, \"{}\"", HEADING.trim());
        assert_eq!(wrong_way(&documented), [""; 0]);
    }

    #[test]
    fn an_arrow_up_the_table_is_allowed_and_an_arrow_down_is_not() {
        let table = "| crate | uses |\n|---|---|\n| `hal` | |\n| `a` | `b` |\n| `b` | `hal`, `a` (optional) |\n";
        let rows = documented(&format!("{HEADING}\n{table}\n## Next\n| `c` | `d` |\n"));
        let used = ["a (optional)".to_owned(), "hal".to_owned()];
        assert_eq!(rows[2], ("b".to_owned(), used.to_vec()));
        assert_eq!(rows.len(), 3);
        assert_eq!(wrong_way(&rows), ["a uses b, which is not above it"]);
    }
}
