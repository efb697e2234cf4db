//! Fits tables and sentences into the width of a terminal, down to 40 columns.

use std::os::fd::AsFd;

use comfy_table::{Row, Table};

/// A narrower terminal is treated like one of this width.
const NARROWEST: usize = 20;

/// Width of the terminal behind standard output, or the environment's `COLUMNS`; `None` if standard output is a file or a pipe,
/// whose lines stay as long as they are.
#[must_use]
pub fn columns() -> Option<usize> {
    columns_of(std::io::stdout())
}

/// As [`columns`], of another stream.
#[must_use]
pub fn columns_of(stream: impl AsFd) -> Option<usize> {
    let given = std::env::var("COLUMNS").ok().and_then(|columns| columns.parse().ok());
    let of_terminal =
        || rustix::termios::tcgetwinsize(stream).ok().map(|size| usize::from(size.ws_col));
    given.or_else(of_terminal).filter(|columns| *columns > 0).map(|columns| columns.max(NARROWEST))
}

/// The table as text. If it is too wide, each row becomes a block: its first cell, and below it one line for every other cell.
/// The header of the first column is above the blocks.
#[must_use]
pub fn table(table: &Table, columns: Option<usize>) -> String {
    let lines: Vec<String> = table.lines().map(|line| line.trim_end().to_owned()).collect();
    let widest = lines.iter().map(|line| line.chars().count()).max().unwrap_or(0);
    let Some(header) = table.header().filter(|_| columns.is_some_and(|columns| widest > columns))
    else {
        return lines.join("\n");
    };
    let header = cells(header);
    let mut blocks = vec![format!("{}:", header.first().map_or("", String::as_str))];
    blocks.extend(table.row_iter().map(|row| block(&header, row)));
    text(&blocks.join("\n"), columns)
}

fn cells(row: &Row) -> Vec<String> {
    row.cell_iter().map(comfy_table::Cell::content).collect()
}

fn block(header: &[String], row: &Row) -> String {
    let cells = cells(row);
    let label_width = header.iter().skip(1).map(|label| label.chars().count()).max().unwrap_or(0);
    let mut block = cells.first().cloned().unwrap_or_default();
    for (label, cell) in header.iter().zip(&cells).skip(1).filter(|(_, cell)| !cell.is_empty()) {
        block += &format!("\n  {label:<label_width$}  {cell}");
    }
    block
}

/// The text with every line that is too long broken at spaces. The rest of a line `label   value` continues below the value, the
/// rest of another line is indented by two more columns.
#[must_use]
pub fn text(text: &str, columns: Option<usize>) -> String {
    let Some(columns) = columns else { return text.to_owned() };
    let lines: Vec<String> = text.split('\n').map(|line| broken(line, columns)).collect();
    lines.join("\n")
}

fn broken(line: &str, columns: usize) -> String {
    if line.chars().count() <= columns {
        return line.to_owned();
    }
    let (label, value) = label_and_value(line, columns / 2);
    let width = label.chars().count();
    let indent = if label.trim().is_empty() { width + 2 } else { width };
    let mut broken = label.to_owned();
    let mut used = width;
    for (place, word) in value.split_whitespace().enumerate() {
        let length = word.chars().count();
        let space = usize::from(place > 0);
        if used + space + length > columns {
            // A long path begins further left rather than being broken.
            used = indent.min(columns.saturating_sub(length));
            broken.truncate(broken.trim_end().len());
            broken = broken + "\n" + &" ".repeat(used);
        } else {
            broken += " ".repeat(space).as_str();
            used += space;
        }
        broken += word;
        used += length;
    }
    broken
}

/// Splits a line behind its indentation, or behind a label that ends with two spaces and is at most `longest` bytes long.
fn label_and_value(line: &str, longest: usize) -> (&str, &str) {
    let indent = line.len() - line.trim_start().len();
    let (_, rest) = line.split_at(indent);
    let Some(label) = rest.find("  ").map(|end| indent + end) else { return line.split_at(indent) };
    let (_, gap) = line.split_at(label);
    let value = label + gap.len() - gap.trim_start().len();
    line.split_at(if value <= longest { value } else { indent })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rest_of_a_long_line_continues_below_its_value_or_indented() {
        let line = "safety       clear for 3.2 s; no stop yet; 0 stops for obstacles";
        let expected =
            "safety       clear for 3.2 s; no stop\n             yet; 0 stops for obstacles";
        assert_eq!(text(line, Some(40)), expected);
        let line = "  ! LiDAR /dev/ttyACM0 is disconnected: plug it in\nshort";
        let expected = "  ! LiDAR /dev/ttyACM0 is\n    disconnected: plug it in\nshort";
        assert_eq!(text(line, Some(30)), expected);
    }

    #[test]
    fn no_line_is_wider_than_the_terminal_and_no_word_is_lost() {
        let line = "depth        93 % within 25 % of the LiDAR, 2 % too short on average; within 25 %: 0-1 m 99 %";
        for columns in 20..100 {
            let fitted = text(line, Some(columns));
            assert!(fitted.lines().all(|line| line.chars().count() <= columns), "{fitted}");
            assert_eq!(words(&fitted), words(line));
        }
        assert_eq!(text(line, None), line);
    }

    fn words(text: &str) -> Vec<&str> {
        text.split_whitespace().collect()
    }

    #[test]
    fn a_table_that_is_too_wide_becomes_a_block_for_each_row() {
        let mut devices = Table::new();
        devices.load_preset(comfy_table::presets::NOTHING);
        devices.set_header(["device", "state", "rate", "details"]);
        devices.add_row(["camera /dev/video0", "working", "29.9 Hz", ""]);
        devices.add_row(["LiDAR /dev/ttyACM0", "silent", "0.0 Hz", "UTM-30LX"]);
        let wide = table(&devices, Some(100));
        assert_eq!(wide.lines().count(), 3, "{wide}");
        let narrow = table(&devices, Some(40));
        let expected = "\
device:
camera /dev/video0
  state    working
  rate     29.9 Hz
LiDAR /dev/ttyACM0
  state    silent
  rate     0.0 Hz
  details  UTM-30LX";
        assert_eq!(narrow, expected);
    }
}
