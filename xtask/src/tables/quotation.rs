//! Cells that quote other tables, so that a figure stands in one place: `{FILE.TABLE[CELL|CELL].COLUMN}` is the cell of COLUMN in the
//! row of docs/data/FILE.json's TABLE that has these cells. With `#N` behind the column it is the N-th of the numbers in that cell.

use anyhow::{Context, Result};

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
        resolved += &cell(quotation).with_context(|| format!("the quotation {{{quotation}}}"))?;
        resolved += rest;
    }
    Ok(resolved)
}

fn cell(quotation: &str) -> Result<String> {
    let (table, rest) = quotation.split_once('[').context("no `[`")?;
    let (row, column) = rest.split_once("].").context("no `].`")?;
    let (file, table) = table.split_once('.').context("no table after the file")?;
    let (column, number) = column.split_once('#').unwrap_or((column, ""));
    let row: Vec<&str> = row.split('|').collect();
    let table = Table::from_json(&data_file(file)?[table])?;
    // Emphasis belongs to the table that is quoted.
    let cell = table.cell(&row, column)?.replace("**", "");
    if number.is_empty() {
        return Ok(cell);
    }
    let index: usize = number.parse().context("the number after `#`")?;
    let found = cell.split(" / ").nth(index.wrapping_sub(1));
    found.map(str::to_owned).with_context(|| format!("`{cell}` has no number {index}"))
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
    fn a_quotation_that_fits_no_cell_or_several_is_refused() {
        for (text, reason) in [
            ("{localization.logs[Intel].relations}", "several rows have the cells"),
            ("{localization.logs[Mars].relations}", "no row has the cells"),
            ("{localization.logs[Intel|wheels].colour}", "no column `colour`"),
            ("{localization.logs[Intel|wheels].relations#2}", "has no number 2"),
            ("{localization.logs", "a `{` without `}`"),
        ] {
            let error = format!("{:#}", resolve(text).unwrap_err());
            assert!(error.contains(reason), "{text}: {error}");
        }
    }
}
