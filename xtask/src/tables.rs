//! The tables of the documents and their data files.
//!
//! A data file `docs/data/NAME.json` says by which command and when its tables were measured. A document holds each table
//! between two markers, and a test checks that it says the same as the data file:
//!
//! ```text
//! <!-- table policies of data/policies.json -->
//!
//! | home | ... |
//!
//! <!-- end of table -->
//! ```
//!
//! A cell can quote cells of other tables, as those of the README do (see [`quotation`]).

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use crate::paths;

mod quotation;

const START: &str = "<!-- table ";
const START_END: &str = " -->\n";
const END: &str = "<!-- end of table -->";

/// A table of texts. Every row has as many cells as there are columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table with these columns and no rows.
    pub fn new(columns: &[&str]) -> Self {
        Self { columns: columns.iter().map(|name| (*name).to_owned()).collect(), rows: Vec::new() }
    }

    /// Adds a row.
    pub fn push(&mut self, cells: Vec<String>) {
        self.rows.push(cells);
    }

    /// The first Markdown table in what a program printed. Rows that follow after other lines belong to it too.
    ///
    /// # Errors
    /// When there is no table, or a row has another number of cells than the head.
    pub fn printed(output: &str) -> Result<Self> {
        let mut lines = output.lines().filter(|line| line.starts_with('|'));
        let columns = cells(lines.next().context("the program printed no table")?);
        Self { columns, rows: lines.skip(1).map(cells).collect() }.checked()
    }

    /// The table in Markdown.
    pub fn markdown(&self) -> String {
        let mut text = line(&self.columns);
        text += &format!("|{}\n", "---|".repeat(self.columns.len()));
        for row in &self.rows {
            text += &line(row);
        }
        text
    }

    fn from_json(value: &Value) -> Result<Self> {
        let columns = texts(&value["columns"])?;
        let rows = value["rows"].as_array().context("a table without rows")?;
        Self { columns, rows: rows.iter().map(texts).collect::<Result<_>>()? }.checked()
    }

    fn checked(self) -> Result<Self> {
        let columns = &self.columns;
        for row in &self.rows {
            ensure!(
                row.len() == columns.len(),
                "the row {row:?} does not fit the head {columns:?}"
            );
        }
        Ok(self)
    }

    /// The same table, with the quotations in its cells replaced by what they quote.
    fn with_quotations(mut self) -> Result<Self> {
        for cell in self.rows.iter_mut().flatten() {
            *cell = quotation::resolve(cell)?;
        }
        Ok(self)
    }

    /// The cell of a column in the only row that has all of these cells.
    fn cell(&self, row: &[&str], column: &str) -> Result<&str> {
        let index = self
            .columns
            .iter()
            .position(|name| name == column)
            .with_context(|| format!("no column `{column}` in {:?}", self.columns))?;
        let mut found = self.rows.iter().filter(|cells| has_all(cells, row));
        let cells = found.next().with_context(|| format!("no row has the cells {row:?}"))?;
        ensure!(found.next().is_none(), "several rows have the cells {row:?}");
        Ok(&cells[index])
    }

    fn to_json(&self) -> Value {
        serde_json::json!({ "columns": self.columns, "rows": self.rows })
    }
}

fn has_all(cells: &[String], wanted: &[&str]) -> bool {
    wanted.iter().all(|text| cells.iter().any(|cell| cell == text))
}

fn texts(value: &Value) -> Result<Vec<String>> {
    let values = value.as_array().with_context(|| format!("{value} is not a list of texts"))?;
    values
        .iter()
        .map(|cell| {
            cell.as_str().map(str::to_owned).with_context(|| format!("{cell} is not a text"))
        })
        .collect()
}

fn cells(line: &str) -> Vec<String> {
    line.trim().trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()
}

fn line(cells: &[String]) -> String {
    let mut text = "|".to_owned();
    for cell in cells {
        text += " ";
        text += cell;
        text += if cell.is_empty() { "|" } else { " |" };
    }
    text + "\n"
}

/// Writes a table that was measured just now into `docs/data/FILE.json`, and into the documents.
///
/// # Errors
/// When a file cannot be read or written, or no document has the table.
pub fn update(file: &str, name: &str, made_by: &str, table: &Table) -> Result<()> {
    update_all(file, made_by, &[(name, table)])
}

/// As [`update`], for all tables of one measurement, by their names.
///
/// # Errors
/// As [`update`].
pub fn update_all(file: &str, made_by: &str, tables: &[(&str, &Table)]) -> Result<()> {
    let path = data_path(file);
    let mut data = data_file(file)?;
    for (name, table) in tables {
        let mut entry = table.to_json();
        entry["made_by"] = made_by.into();
        entry["measured"] = commit()?.into();
        data[*name] = entry;
    }
    std::fs::write(&path, format!("{data:#}\n")).with_context(|| path.display().to_string())?;
    write_documents()?;
    println!("{} and the documents have the new table.", path.display());
    Ok(())
}

fn data_path(file: &str) -> PathBuf {
    paths::root().join("docs/data").join(format!("{file}.json"))
}

fn data_file(file: &str) -> Result<Value> {
    let path = data_path(file);
    let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    serde_json::from_str(&text).with_context(|| path.display().to_string())
}

/// Which build measured: the commit, and whether the checkout differed from it.
fn commit() -> Result<String> {
    let mut git = crate::command::program("git");
    let name = crate::command::output(git.args(["describe", "--always", "--dirty"]))?;
    Ok(format!("by the build of commit {}", name.trim()))
}

/// Writes the tables of all documents as the data files say.
///
/// # Errors
/// When a file cannot be read or written, or a marker has no table.
pub fn write_documents() -> Result<()> {
    for path in documents()? {
        let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let new = with_tables(&text, &path)?;
        if new != text {
            std::fs::write(&path, new).with_context(|| path.display().to_string())?;
        }
    }
    Ok(())
}

/// The README and the Markdown files in `docs`.
fn documents() -> Result<Vec<PathBuf>> {
    let mut found = vec![paths::root().join("README.md")];
    for entry in std::fs::read_dir(paths::root().join("docs"))? {
        found.push(entry?.path());
    }
    found.retain(|path| path.extension().is_some_and(|extension| extension == "md"));
    found.sort();
    Ok(found)
}

/// The text of the document at `path`, with all of its tables as the data files say.
fn with_tables(text: &str, path: &Path) -> Result<String> {
    let folder = path.parent().context("a document is in a folder")?;
    let mut files = BTreeMap::new();
    let mut parts = text.split(START);
    let mut new = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (marker, rest) = part.split_once(START_END).context("a marker without its end")?;
        let (_, rest) =
            rest.split_once(END).with_context(|| format!("`{marker}` has no `{END}`"))?;
        let (name, file) = marker
            .split_once(" of ")
            .with_context(|| format!("the marker `{marker}` is not `NAME of FILE`"))?;
        if !files.contains_key(file) {
            let text = std::fs::read_to_string(folder.join(file)).context(file.to_owned())?;
            files.insert(file, serde_json::from_str::<Value>(&text).context(file.to_owned())?);
        }
        let table = Table::from_json(&files[file][name])
            .and_then(Table::with_quotations)
            .with_context(|| format!("the table {name} of {file}"))?;
        new += &format!("{START}{marker}{START_END}\n{}\n{END}{rest}", table.markdown());
    }
    Ok(new)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_of_the_documents_are_those_of_the_data_files() {
        let mut tables = 0;
        for path in documents().unwrap() {
            let text = std::fs::read_to_string(&path).unwrap();
            tables += text.matches(START).count();
            let expected = with_tables(&text, &path).unwrap();
            assert!(
                text == expected,
                "{} differs from its data files: `cargo xtask tables` writes it",
                path.display()
            );
        }
        assert!(tables >= 3, "only {tables} tables have data files");
    }

    #[test]
    fn every_table_of_a_data_file_is_shown_and_says_how_it_was_measured() {
        let documents: Vec<String> = documents()
            .unwrap()
            .iter()
            .map(|path| std::fs::read_to_string(path).unwrap())
            .collect();
        let mut files = 0;
        for entry in std::fs::read_dir(paths::root().join("docs/data")).unwrap() {
            let path = entry.unwrap().path();
            let file = path.file_stem().unwrap().to_str().unwrap();
            // The figures of the quality gate are no table.
            if file == "quality" {
                continue;
            }
            files += 1;
            let data = data_file(file).unwrap();
            for (name, table) in data.as_object().unwrap() {
                // The README is beside `docs`, the other documents are in it.
                let markers = ["data", "docs/data"]
                    .map(|folder| format!("{START}{name} of {folder}/{file}.json{START_END}"));
                let shown = documents
                    .iter()
                    .filter(|text| markers.iter().any(|marker| text.contains(marker)));
                assert!(shown.count() >= 1, "{markers:?}");
                for key in ["made_by", "measured"] {
                    assert!(!table[key].as_str().unwrap().is_empty(), "{file}: {name}: {key}");
                }
            }
        }
        assert!(files >= 11, "only {files} data files");
    }

    #[test]
    fn a_printed_table_is_read_back_from_its_markdown() {
        let printed = "measuring\n| a | b |\n|---|---|\n| 1 |  |\nmore\n| 2 | x y |\n";
        let table = Table::printed(printed).unwrap();
        assert_eq!(table.markdown(), "| a | b |\n|---|---|\n| 1 | |\n| 2 | x y |\n");
        assert_eq!(Table::from_json(&table.to_json()).unwrap(), table);
        assert!(Table::printed("no table").is_err());
        assert!(Table::printed("| a | b |\n|---|---|\n| 1 |\n").is_err());
    }
}
