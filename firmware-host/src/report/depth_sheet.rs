//! `depth.png`: frames of the run beside their estimated depth, its confidence and its error.

use std::path::Path;

use super::{
    atomic::ReportError,
    canvas::{Canvas, Font},
    colors::{self, Rgb},
    depth_sample::{SampledDepth, SheetRow},
    depth_scale::{DepthScale, hatch},
    percent,
};

/// Name of the file in the output directory.
pub const DEPTH_FILE: &str = "depth.png";

const PAGE: Rgb = [255, 255, 255];
const INK: Rgb = [40, 44, 52];
const FAINT: Rgb = [110, 116, 126];

const GAP: i64 = 12;
/// Heights in pixels: of the title with the column headings, of a row's caption, of the colour
/// bars.
const HEAD: i64 = 70;
const CAPTION: i64 = 20;
const BARS: i64 = 64;
/// Relative error at the end of the colour scale.
const MAX_ERROR: f32 = 0.5;
/// The caption counts pixels with at least this probability.
const CONFIDENT: f32 = 0.9;
/// The possible columns of the sheet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Column {
    Camera,
    Coarse,
    Dense,
    Network,
    Confidence,
    Truth,
    Error,
}

impl Column {
    /// The depth that this column shows.
    fn depth(self, row: &SheetRow) -> Option<&SampledDepth> {
        match self {
            Self::Coarse => row.coarse.as_ref(),
            Self::Dense => row.dense.as_ref(),
            Self::Network => row.network.as_ref(),
            Self::Camera | Self::Confidence | Self::Truth | Self::Error => None,
        }
    }
}

/// A contact sheet: one row per frame, one column per kind of data.
#[derive(Debug, Clone, Copy)]
pub struct DepthSheet<'a> {
    /// Title line that names the run.
    pub title: &'a str,
    /// The rows from top to bottom. All of them must have the same size.
    pub rows: &'a [SheetRow],
    /// The colours of depth, which are the same in all images of a run.
    pub scale: DepthScale,
}

impl DepthSheet<'_> {
    /// Draws the sheet and writes `depth.png` into `dir`. Without rows no file is written.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn write(&self, dir: &Path) -> Result<(), ReportError> {
        match self.draw()? {
            Some(canvas) => canvas.write_png(&dir.join(DEPTH_FILE)),
            None => Ok(()),
        }
    }

    /// Draws the sheet; `None` without rows.
    ///
    /// # Errors
    /// [`ReportError::Shape`] if the rows have different sizes.
    pub fn draw(&self) -> Result<Option<Canvas>, ReportError> {
        let Some(first) = self.rows.first() else { return Ok(None) };
        let width = first.width;
        let height = first.height;
        if let Some(other) = self.rows.iter().find(|row| (row.width, row.height) != (width, height))
        {
            let actual = other.width * other.height;
            return Err(ReportError::Shape {
                what: "row of the contact sheet",
                width,
                height,
                actual,
            });
        }
        let columns = self.columns();
        let layout = Layout {
            columns: columns.len() as i64,
            rows: self.rows.len() as i64,
            width: width as i64,
            height: height as i64,
        };
        let mut canvas = Canvas::new(layout.page_width() as u32, layout.page_height() as u32, PAGE);
        canvas.text(
            GAP,
            10,
            &Font::Title.fit(self.title, layout.page_width() - 2 * GAP),
            Font::Title,
            INK,
        );
        for (index, column) in columns.iter().enumerate() {
            let x = layout.x(index);
            canvas.text(
                x,
                44,
                &Font::Strong.fit(self.heading(*column), layout.width),
                Font::Strong,
                INK,
            );
            for (line, row) in self.rows.iter().enumerate() {
                let y = layout.y(line);
                canvas.text(
                    x,
                    y,
                    &Font::Label.fit(&self.caption(*column, row), layout.width),
                    Font::Label,
                    FAINT,
                );
                self.draw_cell(&mut canvas, *column, row, (x, y + CAPTION));
            }
        }
        draw_bars(&mut canvas, &layout, &self.scale, &columns);
        Ok(Some(canvas))
    }

    /// The columns for which at least one row has data.
    fn columns(&self) -> Vec<Column> {
        let truth = self.has(|row| row.truth.is_some());
        let depth = self.evaluated_column().is_some();
        let shown = [
            (Column::Camera, true),
            (Column::Coarse, self.has(|row| row.coarse.is_some())),
            (Column::Dense, self.has(|row| row.dense.is_some())),
            (Column::Network, self.has(|row| row.network.is_some())),
            (Column::Confidence, depth),
            (Column::Truth, truth),
            (Column::Error, truth && depth),
        ];
        shown.into_iter().filter(|(_, shown)| *shown).map(|(column, _)| column).collect()
    }

    fn has(&self, of: fn(&SheetRow) -> bool) -> bool {
        self.rows.iter().any(of)
    }

    /// The column whose probability and error are shown: the last one that has depth in any row.
    fn evaluated_column(&self) -> Option<Column> {
        let all = [Column::Network, Column::Dense, Column::Coarse];
        all.into_iter().find(|column| self.rows.iter().any(|row| column.depth(row).is_some()))
    }

    fn heading(&self, column: Column) -> &'static str {
        match (column, self.evaluated_column()) {
            (Column::Camera, _) => "camera",
            (Column::Coarse, _) => "coarse depth",
            (Column::Dense, _) => "dense depth",
            (Column::Network, _) => "network depth",
            (Column::Confidence, _) => "probability of being right",
            (Column::Truth, _) => "ground truth",
            (Column::Error, Some(Column::Network)) => "error of the network",
            (Column::Error, Some(Column::Dense)) => "error of dense depth",
            (Column::Error, _) => "error of coarse depth",
        }
    }

    fn evaluated<'r>(&self, row: &'r SheetRow) -> Option<&'r SampledDepth> {
        self.evaluated_column().and_then(|column| column.depth(row))
    }

    fn caption(&self, column: Column, row: &SheetRow) -> String {
        match column {
            Column::Camera => format!("frame {}", row.frame),
            Column::Coarse | Column::Dense | Column::Network => depth_caption(column.depth(row)),
            Column::Truth => String::new(),
            Column::Confidence => self.evaluated(row).map_or_else(String::new, |depth| {
                let confident =
                    depth.confidence.iter().filter(|confidence| **confidence >= CONFIDENT).count();
                let share = confident as f64 / depth.confidence.len().max(1) as f64;
                format!("{} of pixels above {CONFIDENT}", percent(share))
            }),
            Column::Error => match self.evaluated(row).and_then(|depth| depth.abs_rel) {
                Some(abs_rel) => format!("mean {:.0} %", 100.0 * abs_rel),
                None => String::new(),
            },
        }
    }

    fn draw_cell(&self, canvas: &mut Canvas, column: Column, row: &SheetRow, at: (i64, i64)) {
        let scale = &self.scale;
        let evaluated = self.evaluated(row);
        let truth = row.truth.as_deref();
        for index in 0..row.width * row.height {
            let color = match column {
                Column::Camera => Some(row.rgb[index]),
                Column::Coarse | Column::Dense | Column::Network => {
                    scale.color_of(depth_at(column.depth(row), index))
                }
                Column::Confidence => {
                    let confidence = evaluated.map_or(0.0, |depth| depth.confidence[index]);
                    (confidence > 0.0).then(|| colors::probability(f64::from(confidence)))
                }
                Column::Truth => scale.color_of(truth.map_or(0.0, |truth| truth[index])),
                Column::Error => {
                    let predicted = depth_at(evaluated, index);
                    let truth = truth.map_or(0.0, |truth| truth[index]);
                    (predicted > 0.0 && truth > 0.0)
                        .then(|| error_color((predicted - truth).abs() / truth))
                }
            };
            let x = at.0 + (index % row.width) as i64;
            let y = at.1 + (index / row.width) as i64;
            canvas.blend(x, y, color.unwrap_or_else(|| hatch(x, y)), 1.0);
        }
    }
}

/// Depth at a pixel, metres; 0 if there is none.
fn depth_at(depth: Option<&SampledDepth>, index: usize) -> f32 {
    depth.map_or(0.0, |depth| depth.depth_m[index])
}

fn depth_caption(depth: Option<&SampledDepth>) -> String {
    match depth {
        None => "no depth".to_owned(),
        Some(SampledDepth { delta1: Some(delta1), share, .. }) => {
            format!("{} of pixels, delta1 {delta1:.2} unscaled", percent(*share))
        }
        Some(SampledDepth { share, .. }) => format!("{} of pixels", percent(*share)),
    }
}

fn error_color(relative: f32) -> Rgb {
    colors::error(f64::from(relative / MAX_ERROR))
}

/// Positions of the cells on the page, pixels.
#[derive(Debug, Clone, Copy)]
struct Layout {
    columns: i64,
    rows: i64,
    width: i64,
    height: i64,
}

impl Layout {
    fn x(&self, column: usize) -> i64 {
        GAP + column as i64 * (self.width + GAP)
    }

    fn y(&self, row: usize) -> i64 {
        HEAD + row as i64 * (CAPTION + self.height + GAP)
    }

    fn page_width(&self) -> i64 {
        // The colour bars and the label for missing depth need this width.
        (GAP + self.columns * (self.width + GAP)).max(1180)
    }

    fn page_height(&self) -> i64 {
        self.y(self.rows as usize) + BARS
    }
}

fn draw_bars(canvas: &mut Canvas, layout: &Layout, scale: &DepthScale, columns: &[Column]) {
    let y = layout.page_height() - BARS + 14;
    let bar = Bar { x: GAP + Font::Label.width("depth (m) "), y, width: 300 };
    let ticks = scale.ticks();
    bar.draw(canvas, "depth (m)", |share| colors::depth(f64::from(share)), &ticks);
    let mut right = bar.x + bar.width + 40;
    if columns.contains(&Column::Confidence) {
        let bar = Bar { x: right + Font::Label.width("probability "), y, width: 160 };
        let ticks =
            [(0.0, "0"), (0.5, "0.5"), (1.0, "1")].map(|(at, label)| (at, label.to_owned()));
        bar.draw(canvas, "probability", |share| colors::probability(f64::from(share)), &ticks);
        right = bar.x + bar.width + 40;
    }
    if columns.contains(&Column::Error) {
        let bar = Bar { x: right + Font::Label.width("error "), y, width: 200 };
        let ticks = [(0.0, "0"), (0.2, "10 %"), (0.5, "25 %"), (1.0, "50 %+")]
            .map(|(at, label)| (at, label.to_owned()));
        bar.draw(canvas, "error", |share| error_color(share * MAX_ERROR), &ticks);
        right = bar.x + bar.width + 40;
    }
    for row in y..y + 16 {
        for column in right..right + 28 {
            canvas.blend(column, row, hatch(column, row), 1.0);
        }
    }
    canvas.text(right + 36, y, "no depth", Font::Label, INK);
}

/// A colour bar with its name on the left and tick labels below.
struct Bar {
    x: i64,
    y: i64,
    width: i64,
}

impl Bar {
    fn draw(
        &self,
        canvas: &mut Canvas,
        name: &str,
        color: impl Fn(f32) -> Rgb,
        ticks: &[(f32, String)],
    ) {
        canvas.text(self.x - Font::Label.width(name) - 8, self.y, name, Font::Label, INK);
        for step in 0..self.width {
            canvas.fill(self.x + step, self.y, 1, 16, color(step as f32 / (self.width - 1) as f32));
        }
        canvas.frame(self.x - 1, self.y - 1, self.width + 2, 18, FAINT);
        for (share, label) in ticks {
            let at = self.x + (share * (self.width - 1) as f32).round() as i64;
            canvas.fill(at, self.y + 16, 1, 5, INK);
            canvas.text_centered(at, self.y + 22, label, Font::Label, INK);
        }
    }
}

#[cfg(test)]
#[path = "depth_sheet_tests.rs"]
mod tests;
