//! An RGB image with drawing functions: rectangles, anti-aliased lines and markers, text.

use std::{io::Cursor, path::Path};

use image::{ImageFormat, Rgb as Pixel, RgbImage};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use super::{
    atomic::{ReportError, write_atomically},
    colors::{Rgb, mix},
};

/// Size and weight of a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Font {
    /// 16 pixels high, for labels.
    Label,
    /// 16 pixels high and bold, for column headings.
    Strong,
    /// 20 pixels high and bold, for titles.
    Title,
}

impl Font {
    fn raster(self) -> (FontWeight, RasterHeight) {
        match self {
            Self::Label => (FontWeight::Regular, RasterHeight::Size16),
            Self::Strong => (FontWeight::Bold, RasterHeight::Size16),
            Self::Title => (FontWeight::Bold, RasterHeight::Size20),
        }
    }

    /// Width of `text` in pixels.
    #[must_use]
    pub fn width(self, text: &str) -> i64 {
        let (weight, height) = self.raster();
        (text.chars().count() * get_raster_width(weight, height)) as i64
    }

    /// `text` shortened to `width` pixels. A shortened text ends with three dots.
    #[must_use]
    pub fn fit(self, text: &str, width: i64) -> String {
        let capacity = (width / self.width("x")).max(0) as usize;
        if text.chars().count() <= capacity {
            return text.to_owned();
        }
        let kept: String = text.chars().take(capacity.saturating_sub(3)).collect();
        kept + "..."
    }
}

/// An RGB image to draw on. Drawing outside of it has no effect. Pixel centres are at integer
/// coordinates.
#[derive(Debug, Clone)]
pub struct Canvas {
    image: RgbImage,
}

impl Canvas {
    /// An image filled with one colour.
    #[must_use]
    pub fn new(width: u32, height: u32, background: Rgb) -> Self {
        Self { image: RgbImage::from_pixel(width, height, Pixel(background)) }
    }

    /// Width and height in pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        self.image.dimensions()
    }

    /// The pixels, row by row: three bytes for each.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        self.image.as_raw()
    }

    /// The colour of a pixel; `None` outside of the image.
    #[must_use]
    pub fn get(&self, x: i64, y: i64) -> Option<Rgb> {
        let x = u32::try_from(x).ok()?;
        let y = u32::try_from(y).ok()?;
        self.image.get_pixel_checked(x, y).map(|pixel| pixel.0)
    }

    /// Blends `color` over a pixel. `opacity` is from 0 to 1.
    pub fn blend(&mut self, x: i64, y: i64, color: Rgb, opacity: f64) {
        if let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y))
            && let Some(pixel) = self.image.get_pixel_mut_checked(x, y)
        {
            pixel.0 = mix(pixel.0, color, opacity);
        }
    }

    /// Draws a filled rectangle.
    pub fn fill(&mut self, x: i64, y: i64, width: i64, height: i64, color: Rgb) {
        for row in y..y + height {
            for column in x..x + width {
                self.blend(column, row, color, 1.0);
            }
        }
    }

    /// Draws the outline of a rectangle, one pixel wide, inside of its edges.
    pub fn frame(&mut self, x: i64, y: i64, width: i64, height: i64, color: Rgb) {
        self.fill(x, y, width, 1, color);
        self.fill(x, y + height - 1, width, 1, color);
        self.fill(x, y, 1, height, color);
        self.fill(x + width - 1, y, 1, height, color);
    }

    /// Draws a straight line with round ends.
    pub fn line(&mut self, a: [f64; 2], b: [f64; 2], width: f64, color: Rgb, opacity: f64) {
        let middle = [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0];
        let reach = (a[0] - b[0]).hypot(a[1] - b[1]) / 2.0 + width;
        self.shape(middle, reach, color, opacity, |point| {
            distance_to_segment(point, a, b) - width / 2.0
        });
    }

    /// Draws a filled circle.
    pub fn disc(&mut self, center: [f64; 2], radius: f64, color: Rgb) {
        self.shape(center, radius, color, 1.0, |[x, y]| {
            (x - center[0]).hypot(y - center[1]) - radius
        });
    }

    /// Draws a square standing on a corner. `radius` is the distance from centre to corner.
    pub fn diamond(&mut self, center: [f64; 2], radius: f64, color: Rgb) {
        self.shape(center, radius, color, 1.0, |[x, y]| {
            ((x - center[0]).abs() + (y - center[1]).abs() - radius) / 2f64.sqrt()
        });
    }

    /// Draws a filled triangle.
    pub fn triangle(&mut self, corners: [[f64; 2]; 3], color: Rgb) {
        let [a, b, c] = corners;
        let center = [(a[0] + b[0] + c[0]) / 3.0, (a[1] + b[1] + c[1]) / 3.0];
        let reach = corners.map(|corner| (corner[0] - center[0]).hypot(corner[1] - center[1]));
        let reach = reach.into_iter().fold(0.0, f64::max);
        // The centre is inside, so the sign does not depend on the order of the corners.
        let sides = [(a, b), (b, c), (c, a)];
        self.shape(center, reach, color, 1.0, |point| {
            sides
                .map(|(p, q)| beside(point, p, q) * -beside(center, p, q).signum())
                .into_iter()
                .fold(f64::NEG_INFINITY, f64::max)
        });
    }

    /// Draws an X. `radius` is the extent from the centre along each axis.
    pub fn cross(&mut self, center: [f64; 2], radius: f64, width: f64, color: Rgb) {
        let [x, y] = center;
        self.line([x - radius, y - radius], [x + radius, y + radius], width, color, 1.0);
        self.line([x - radius, y + radius], [x + radius, y - radius], width, color, 1.0);
    }

    /// Draws, anti-aliased, a shape that is given by its signed distance (negative inside). `reach`
    /// is the largest extent of the shape from `center`.
    fn shape(
        &mut self,
        center: [f64; 2],
        reach: f64,
        color: Rgb,
        opacity: f64,
        distance: impl Fn([f64; 2]) -> f64,
    ) {
        let columns = covered(center[0], reach, self.image.width());
        let rows = covered(center[1], reach, self.image.height());
        for y in rows {
            for x in columns.clone() {
                let coverage = (0.5 - distance([x as f64, y as f64])).clamp(0.0, 1.0);
                if coverage > 0.0 {
                    self.blend(x, y, color, coverage * opacity);
                }
            }
        }
    }

    /// Draws text with its upper left corner at (`x`, `y`). Characters that the font does not have
    /// are drawn as question marks.
    pub fn text(&mut self, x: i64, y: i64, text: &str, font: Font, color: Rgb) {
        let (weight, height) = font.raster();
        let advance = get_raster_width(weight, height) as i64;
        for (index, letter) in text.chars().enumerate() {
            let Some(raster) =
                get_raster(letter, weight, height).or_else(|| get_raster('?', weight, height))
            else {
                continue;
            };
            let left = x + index as i64 * advance;
            for (row, values) in raster.rows().enumerate() {
                for (column, value) in values.iter().enumerate() {
                    self.blend(
                        left + column as i64,
                        y + row as i64,
                        color,
                        f64::from(*value) / 255.0,
                    );
                }
            }
        }
    }

    /// Draws text centred at column `x`.
    pub fn text_centered(&mut self, x: i64, y: i64, text: &str, font: Font, color: Rgb) {
        self.text(x - font.width(text) / 2, y, text, font, color);
    }

    /// Writes a PNG file atomically.
    ///
    /// # Errors
    /// [`ReportError::Encoding`] or [`ReportError::Unwritable`].
    pub fn write_png(&self, path: &Path) -> Result<(), ReportError> {
        let mut bytes = Cursor::new(Vec::new());
        let encoded = self.image.write_to(&mut bytes, ImageFormat::Png);
        encoded.map_err(|error| ReportError::Encoding {
            path: path.to_path_buf(),
            message: error.to_string(),
        })?;
        write_atomically(path, bytes.get_ref())
    }
}

/// Pixels of one axis that a shape may cover. The range is empty if `center` is NaN, and is limited
/// to the image if it is huge.
fn covered(center: f64, reach: f64, size: u32) -> std::ops::Range<i64> {
    let end = f64::from(size);
    let low = (center - reach - 1.0).floor().clamp(0.0, end) as i64;
    let high = (center + reach + 2.0).ceil().clamp(0.0, end) as i64;
    low..high
}

/// Signed distance of a point from the line through `p` and `q`.
fn beside(point: [f64; 2], p: [f64; 2], q: [f64; 2]) -> f64 {
    let [dx, dy] = [q[0] - p[0], q[1] - p[1]];
    (dx * (point[1] - p[1]) - dy * (point[0] - p[0])) / dx.hypot(dy).max(f64::MIN_POSITIVE)
}

fn distance_to_segment(point: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let along = [b[0] - a[0], b[1] - a[1]];
    let to = [point[0] - a[0], point[1] - a[1]];
    let squared = along[0] * along[0] + along[1] * along[1];
    let share = if squared > 0.0 {
        ((to[0] * along[0] + to[1] * along[1]) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (to[0] - share * along[0]).hypot(to[1] - share * along[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHITE: Rgb = [255; 3];
    const RED: Rgb = [200, 0, 0];

    fn painted(canvas: &Canvas) -> usize {
        canvas.image.pixels().filter(|pixel| pixel.0 != WHITE).count()
    }

    fn with_text(text: &str) -> Canvas {
        let mut canvas = Canvas::new(60, 30, WHITE);
        canvas.text(4, 5, text, Font::Label, [0; 3]);
        canvas
    }

    #[test]
    fn a_line_has_the_requested_width() {
        let mut canvas = Canvas::new(40, 40, WHITE);
        canvas.line([5.0, 20.0], [35.0, 20.0], 3.0, RED, 1.0);
        let column: Vec<bool> = (0..40).map(|y| canvas.get(20, y) == Some(RED)).collect();
        assert_eq!(column.iter().filter(|hit| **hit).count(), 3);
        assert!(column[19] && column[20] && column[21]);
    }

    #[test]
    fn a_disc_has_the_area_of_a_disc() {
        let mut canvas = Canvas::new(60, 60, [0; 3]);
        canvas.disc([30.2, 29.7], 20.0, [255; 3]);
        let area: f64 = canvas.image.pixels().map(|pixel| f64::from(pixel.0[0]) / 255.0).sum();
        assert!((area - std::f64::consts::PI * 400.0).abs() < 8.0, "{area}");
    }

    #[test]
    fn drawing_outside_or_at_nan_changes_nothing() {
        let mut canvas = Canvas::new(10, 10, WHITE);
        canvas.fill(-30, -30, 20, 20, RED);
        canvas.disc([1e18, 3.0], 4.0, RED);
        canvas.disc([f64::NAN, 3.0], 4.0, RED);
        canvas.line([f64::NAN, 1.0], [3.0, f64::INFINITY], 2.0, RED, 1.0);
        canvas.text(500, 5, "far", Font::Label, RED);
        assert_eq!(painted(&canvas), 0);
    }

    #[test]
    fn text_stays_in_its_box_and_unknown_characters_become_question_marks() {
        let canvas = with_text("Mg1");
        let right = 4 + Font::Label.width("Mg1");
        assert!(painted(&canvas) > 30);
        for y in 0..30 {
            for x in 0..60 {
                let inside = (4..right).contains(&x) && (5..21).contains(&y);
                assert!(inside || canvas.get(x, y) == Some(WHITE), "{x} {y}");
            }
        }
        assert_eq!(with_text("\u{4e00}").image, with_text("?").image);
    }

    #[test]
    fn a_text_that_is_too_long_ends_in_dots() {
        assert_eq!(Font::Label.fit("short", 1000), "short");
        let cut = Font::Label.fit("a very long name of a scene", 100);
        assert!(cut.ends_with("...") && Font::Label.width(&cut) <= 100);
    }

    #[test]
    fn the_file_is_a_png_of_the_same_pixels() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("picture.png");
        let mut canvas = Canvas::new(20, 10, WHITE);
        canvas.diamond([10.0, 5.0], 3.0, RED);
        canvas.write_png(&path).unwrap();
        assert_eq!(image::open(&path).unwrap().into_rgb8(), canvas.image);
    }
}
