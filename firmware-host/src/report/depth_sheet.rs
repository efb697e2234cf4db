//! `depth.png`: pictures of the run beside the depth that was computed for them, and how wrong it was.

use std::path::Path;

use super::{
    atomic::ReportError,
    canvas::{Canvas, Font},
    colors::{self, Rgb},
    depth_sample::{SampledDepth, SheetRow},
};

/// Name of the file in the output directory.
pub const DEPTH_FILE: &str = "depth.png";

const PAGE: Rgb = [255, 255, 255];
const INK: Rgb = [40, 44, 52];
const FAINT: Rgb = [110, 116, 126];
const NO_DEPTH: [Rgb; 2] = [[92, 94, 99], [112, 114, 119]];

const GAP: i64 = 12;
/// Heights of the title with the columns' names, of a row's caption and of the colour bars.
const HEAD: i64 = 70;
const CAPTION: i64 = 20;
const BARS: i64 = 64;
/// A relative error of this and more has the last colour.
const WORST: f32 = 0.5;
/// A pixel that is as probably right as this counts as sure.
const SURE: f32 = 0.9;
/// Depths that a colour bar may name, metres.
const TICKS_M: [f32; 14] =
    [0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 20.0];

/// What a column shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Column {
    Camera,
    Coarse,
    Network,
    Confidence,
    Truth,
    Error,
}

/// A contact sheet.
#[derive(Debug, Clone, Copy)]
pub struct DepthSheet<'a> {
    /// One line: which run this is.
    pub title: &'a str,
    /// From top to bottom; all of the same size.
    pub rows: &'a [SheetRow],
}

impl DepthSheet<'_> {
    /// Draws and writes `depth.png` into `dir`. Without any row there is nothing to draw and no file is written.
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
    /// [`ReportError::Shape`] when the rows do not have one size.
    pub fn draw(&self) -> Result<Option<Canvas>, ReportError> {
        let Some(first) = self.rows.first() else { return Ok(None) };
        let (width, height) = (first.width, first.height);
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
        let scale = DepthScale::of(self.rows);
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
                self.draw_cell(&mut canvas, *column, row, &scale, (x, y + CAPTION));
            }
        }
        draw_bars(&mut canvas, &layout, &scale, &columns);
        Ok(Some(canvas))
    }

    /// Columns that have something to show in some row.
    fn columns(&self) -> Vec<Column> {
        let any = |has: fn(&SheetRow) -> bool| self.rows.iter().any(has);
        let (coarse, network, truth) =
            (any(|r| r.coarse.is_some()), any(|r| r.network.is_some()), any(|r| r.truth.is_some()));
        let shown = [
            (Column::Camera, true),
            (Column::Coarse, coarse),
            (Column::Network, network),
            (Column::Confidence, coarse || network),
            (Column::Truth, truth),
            (Column::Error, truth && (coarse || network)),
        ];
        shown.into_iter().filter(|(_, shown)| *shown).map(|(column, _)| column).collect()
    }

    /// Whether the error is the network's; else it is coarse depth's.
    fn judges_network(&self) -> bool {
        self.rows.iter().any(|row| row.network.is_some())
    }

    fn heading(&self, column: Column) -> &'static str {
        match column {
            Column::Camera => "camera",
            Column::Coarse => "coarse depth",
            Column::Network => "network depth",
            Column::Confidence => "probability that it is right",
            Column::Truth => "ground truth",
            Column::Error if self.judges_network() => "error of the network",
            Column::Error => "error of coarse depth",
        }
    }

    fn judged<'r>(&self, row: &'r SheetRow) -> Option<&'r SampledDepth> {
        if self.judges_network() { row.network.as_ref() } else { row.coarse.as_ref() }
    }

    fn caption(&self, column: Column, row: &SheetRow) -> String {
        let depth = |depth: Option<&SampledDepth>| match depth {
            None => "no depth".to_owned(),
            Some(SampledDepth { delta1: Some(delta1), share, .. }) => {
                format!("{:.0} % of pixels, delta1 {delta1:.2} unscaled", 100.0 * share)
            }
            Some(SampledDepth { share, .. }) => format!("{:.0} % of pixels", 100.0 * share),
        };
        match column {
            Column::Camera => format!("frame {}", row.frame),
            Column::Coarse => depth(row.coarse.as_ref()),
            Column::Network => depth(row.network.as_ref()),
            Column::Truth => String::new(),
            Column::Confidence => self.judged(row).map_or_else(String::new, |judged| {
                let sure =
                    judged.confidence.iter().filter(|confidence| **confidence >= SURE).count();
                format!(
                    "{:.0} % of pixels above {SURE}",
                    100.0 * sure as f64 / judged.confidence.len().max(1) as f64
                )
            }),
            Column::Error => match self.judged(row).and_then(|judged| judged.abs_rel) {
                Some(abs_rel) => format!("mean {:.0} %", 100.0 * abs_rel),
                None => String::new(),
            },
        }
    }

    fn draw_cell(
        &self,
        canvas: &mut Canvas,
        column: Column,
        row: &SheetRow,
        scale: &DepthScale,
        at: (i64, i64),
    ) {
        let value = |depth: Option<&[f32]>, index: usize| depth.map_or(0.0, |depth| depth[index]);
        let depth_color = |depth: f32| (depth > 0.0).then(|| scale.color(depth));
        let of = |depth: &Option<SampledDepth>, index| {
            value(depth.as_ref().map(|depth| &depth.depth_m[..]), index)
        };
        for index in 0..row.width * row.height {
            let color = match column {
                Column::Camera => Some(row.rgb[index]),
                Column::Coarse => depth_color(of(&row.coarse, index)),
                Column::Network => depth_color(of(&row.network, index)),
                Column::Confidence => {
                    let confidence =
                        value(self.judged(row).map(|judged| &judged.confidence[..]), index);
                    (confidence > 0.0).then(|| colors::error(1.0 - f64::from(confidence)))
                }
                Column::Truth => depth_color(value(row.truth.as_deref(), index)),
                Column::Error => {
                    let predicted =
                        value(self.judged(row).map(|judged| &judged.depth_m[..]), index);
                    let truth = value(row.truth.as_deref(), index);
                    (predicted > 0.0 && truth > 0.0)
                        .then(|| error_color((predicted - truth).abs() / truth))
                }
            };
            let (x, y) = (at.0 + (index % row.width) as i64, at.1 + (index / row.width) as i64);
            canvas.blend(x, y, color.unwrap_or_else(|| hatch(x, y)), 1.0);
        }
    }
}

/// Where no value is: stripes that no colour scale has.
fn hatch(x: i64, y: i64) -> Rgb {
    NO_DEPTH[usize::from((x + y).rem_euclid(8) < 2)]
}

fn error_color(relative: f32) -> Rgb {
    colors::error(f64::from(relative / WORST))
}

/// One colour scale for all depths of a sheet: near is warm, equal ratios are equal steps.
#[derive(Debug, Clone, Copy)]
struct DepthScale {
    near_m: f32,
    far_m: f32,
}

impl DepthScale {
    /// From the 1st to the 99th percentile of what is shown, of the ground truth where there is any.
    fn of(rows: &[SheetRow]) -> Self {
        let truth = rows.iter().filter_map(|row| row.truth.as_deref());
        let computed = rows
            .iter()
            .flat_map(|row| [&row.coarse, &row.network])
            .flatten()
            .map(|depth| &depth.depth_m[..]);
        let valid = |depths: &mut dyn Iterator<Item = &[f32]>| -> Vec<f32> {
            depths.flatten().copied().filter(|depth| *depth > 0.0).collect()
        };
        let mut depths = valid(&mut truth.into_iter());
        if depths.is_empty() {
            depths = valid(&mut computed.into_iter());
        }
        depths.sort_unstable_by(f32::total_cmp);
        let at = |share: usize| depths.get(depths.len() * share / 100).copied();
        let (near_m, far_m) = (at(1).unwrap_or(0.3), at(99).unwrap_or(10.0));
        // A picture of one wall still needs a scale.
        Self { near_m, far_m: far_m.max(1.2 * near_m) }
    }

    /// 0 at the near end, 1 at the far end.
    fn share(&self, depth_m: f32) -> f32 {
        (depth_m / self.near_m).ln() / (self.far_m / self.near_m).ln()
    }

    /// Depths worth naming and where they stand: none so close to the one before that their labels would touch.
    fn ticks(&self) -> Vec<(f32, String)> {
        let mut ticks: Vec<(f32, String)> = Vec::new();
        for tick_m in TICKS_M {
            let share = self.share(tick_m);
            let room = ticks.last().is_none_or(|(last, _)| share - last > 0.1);
            if room && (0.0..=1.0).contains(&share) {
                ticks.push((share, format!("{tick_m}")));
            }
        }
        ticks
    }

    fn color(&self, depth_m: f32) -> Rgb {
        near_warm(self.share(depth_m))
    }
}

/// Turbo without its darkest ends, so that the farthest and nearest still differ from ink.
fn near_warm(share: f32) -> Rgb {
    colors::turbo(0.05 + 0.88 * (1.0 - f64::from(share).clamp(0.0, 1.0)))
}

/// Where the cells stand.
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
        // The colour bars and the word for no depth need this much.
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
    bar.draw(canvas, "depth (m)", near_warm, &ticks);
    let mut right = bar.x + bar.width + 40;
    if columns.contains(&Column::Confidence) {
        let bar = Bar { x: right + Font::Label.width("probability "), y, width: 160 };
        let ticks =
            [(0.0, "0"), (0.5, "0.5"), (1.0, "1")].map(|(at, label)| (at, label.to_owned()));
        bar.draw(canvas, "probability", |share| colors::error(1.0 - f64::from(share)), &ticks);
        right = bar.x + bar.width + 40;
    }
    if columns.contains(&Column::Error) {
        let bar = Bar { x: right + Font::Label.width("error "), y, width: 200 };
        let ticks = [(0.0, "0"), (0.2, "10 %"), (0.5, "25 %"), (1.0, "50 %+")]
            .map(|(at, label)| (at, label.to_owned()));
        bar.draw(canvas, "error", |share| error_color(share * WORST), &ticks);
        right = bar.x + bar.width + 40;
    }
    for row in y..y + 16 {
        for column in right..right + 28 {
            canvas.blend(column, row, hatch(column, row), 1.0);
        }
    }
    canvas.text(right + 36, y, "no depth", Font::Label, INK);
}

/// A colour scale with its name on the left and its ticks below.
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
