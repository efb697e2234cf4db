//! Cells that quote cells of other tables, so that each figure is written in one place only.
//!
//! `{FILE.TABLE[CELL|CELL].COLUMN}` is the cell in column COLUMN of table TABLE in docs/data/FILE.json, in the only row that has these
//! cells. A cell such as "3.59 / 42.08" has several values; `#N` after the column takes the N-th of them.

use anyhow::{Context, Result, ensure};

use super::{Table, data_file};

/// The text with all of its quotations resolved.
///
/// # Errors
/// When a quotation is not of the form above, or its table has no such cell, or several.
pub fn resolve(text: &str) -> Result<String> {
    let mut parts = text.split('{');
    let mut resolved = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (quotation, rest) = part.split_once('}').context("a `{` without `}`")?;
        resolved += &quoted(quotation).with_context(|| format!("the quotation {{{quotation}}}"))?;
        resolved += rest;
    }
    Ok(resolved)
}

fn quoted(quotation: &str) -> Result<String> {
    let (source, rest) = quotation.split_once('[').context("no `[`")?;
    let (row, column) = rest.split_once("].").context("no `].`")?;
    let (file, name) = source.split_once('.').context("no table after the file")?;
    let (column, number) = match column.split_once('#') {
        Some((column, number)) => (column, Some(number)),
        None => (column, None),
    };
    let row: Vec<&str> = row.split('|').collect();
    let table = Table::from_json(&data_file(file)?[name])
        .with_context(|| format!("the table {name} of {file}"))?;
    let cell = table.cell(&row, column)?;
    ensure!(!cell.contains('{'), "`{cell}` is itself a quotation: quote the cell that it quotes");
    value(cell, number)
}

/// A cell without its emphasis, which belongs to the table that is quoted, or one of its values.
fn value(cell: &str, number: Option<&str>) -> Result<String> {
    let cell = cell.replace("**", "");
    let Some(number) = number else { return Ok(cell) };
    let number: usize = number.parse().context("the number after `#`")?;
    let index = number.checked_sub(1).context("the first value is `#1`")?;
    let found = cell.split(" / ").nth(index);
    found.map(str::to_owned).with_context(|| format!("`{cell}` has no value {number}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quotation_is_the_cell_of_the_only_row_that_fits() {
        let text = "a {localization.logs[Intel|wheels].relations} b";
        assert_eq!(resolve(text).unwrap(), "a 964 b");
        assert_eq!(resolve("no quotation").unwrap(), "no quotation");
    }

    #[test]
    fn a_number_takes_one_value_of_a_cell_and_emphasis_is_not_quoted() {
        let values = [None, Some("1"), Some("2")].map(|number| value("**.842** / 7", number));
        assert_eq!(values.map(Result::unwrap), [".842 / 7", ".842", "7"]);
        for number in ["", "0", "3", "x"] {
            assert!(value("**.842** / 7", Some(number)).is_err(), "{number}");
        }
    }

    #[test]
    fn a_quotation_that_fits_no_cell_or_several_is_refused() {
        for (text, reason) in [
            ("{localization.logs[Intel].relations}", "several rows have the cells"),
            ("{localization.logs[Mars].relations}", "no row has the cells"),
            ("{localization.logs[Intel|wheels].colour}", "no column `colour`"),
            ("{localization.lags[Intel|wheels].relations}", "the table lags of localization"),
            ("{localization.logs[Intel|wheels].relations#2}", "has no value 2"),
            ("{localization.logs", "a `{` without `}`"),
        ] {
            let error = format!("{:#}", resolve(text).unwrap_err());
            assert!(error.contains(reason), "{text}: {error}");
        }
    }
}
