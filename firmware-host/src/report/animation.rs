//! `animation.png`: the map as it grows beside the camera's frames and their depth, as an animated
//! PNG, which browsers and GitHub play.

use std::{path::Path, time::Duration};

use hal::Pose2;
use png::{BitDepth, ColorType, Compression, Encoder, EncodingError};

use super::{
    atomic::{ReportError, write_atomically},
    canvas::{Canvas, Font},
    colors::{self, Rgb},
    depth_sample::SheetRow,
    depth_scale::{DepthScale, hatch},
    map_image::{CellState, Cells, END, FAINT, FREE, INK, OCCUPIED, PAGE, UNKNOWN},
    percent,
};

/// Name of the file in the output directory.
pub const ANIMATION_FILE: &str = "animation.png";

/// Number of images of an animation that runs to its end.
pub const SHOTS: u64 = 60;
/// Largest file, bytes: what a web page can load at once. A larger animation loses every second
/// image.
const MAX_BYTES: usize = 3_000_000;
/// Time for which an image is shown, and the last one.
const SHOWN: Duration = Duration::from_millis(100);
const LAST_SHOWN: Duration = Duration::from_millis(2500);

const GAP: i64 = 12;
/// Height of the title and of a label above a panel, pixels.
const TITLE: i64 = 40;
const LABEL: i64 = 20;
/// Largest side of the map, pixels.
const MAP_SIDE: f64 = 360.0;

/// One image of the animation.
#[derive(Debug, Clone)]
pub struct Shot {
    /// The camera's frame and its depth.
    pub row: SheetRow,
    /// The map at that moment, row-major in the animation's grid.
    pub cells: Vec<CellState>,
    /// Share of the reachable floor that was mapped.
    pub coverage: Option<f64>,
}

/// The content of the animation. Positions are in the frame of the map's grid, metres.
#[derive(Debug, Clone, Copy)]
pub struct Animation<'a> {
    pub title: &'a str,
    /// The images in the order of time, with frames and maps of the same size.
    pub shots: &'a [Shot],
    /// Number of columns of the maps.
    pub map_width: usize,
    /// Side of a cell.
    pub resolution_m: f64,
    /// Pose of the robot in each frame of the run, as it believed.
    pub trajectory: &'a [Pose2],
    /// Outer corner of the grid's first cell.
    pub origin_m: [f64; 2],
    /// The colours of depth, which are the same in all images of a run.
    pub scale: DepthScale,
}

impl Animation<'_> {
    /// Draws the images and writes `animation.png` into `dir`. Without shots no file is written.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn write(&self, dir: &Path) -> Result<(), ReportError> {
        let path = dir.join(ANIMATION_FILE);
        let mut images = self.draw();
        let mut shown = SHOWN;
        while !images.is_empty() {
            let bytes = encode(&images, shown).map_err(|error| ReportError::Encoding {
                path: path.clone(),
                message: error.to_string(),
            })?;
            if bytes.len() <= MAX_BYTES || images.len() == 1 {
                return write_atomically(&path, &bytes);
            }
            images = every_second(images);
            shown *= 2;
        }
        Ok(())
    }

    fn draw(&self) -> Vec<Canvas> {
        self.shots.iter().map(|shot| self.draw_shot(shot, &self.scale)).collect()
    }

    fn draw_shot(&self, shot: &Shot, scale: &DepthScale) -> Canvas {
        let frame_width = shot.row.width as i64;
        let frame_height = shot.row.height as i64;
        let map = MapPanel::new(self, shot, 2 * GAP + frame_width);
        let panel_height = LABEL + frame_height + GAP;
        let page_height = TITLE + (2 * panel_height + 2 * LABEL).max(map.height + GAP);
        let mut canvas = Canvas::new(map.page_width() as u32, page_height as u32, PAGE);
        let title = Font::Strong.fit(self.title, map.page_width() - 2 * GAP);
        canvas.text(GAP, 10, &title, Font::Strong, INK);
        draw_frame(&mut canvas, &shot.row, TITLE);
        draw_depth(&mut canvas, &shot.row, scale, TITLE + panel_height);
        let caption = self.caption(shot);
        canvas.text(GAP, TITLE + 2 * panel_height, &caption, Font::Label, INK);
        map.draw(&mut canvas);
        canvas
    }

    fn caption(&self, shot: &Shot) -> String {
        let mapped =
            shot.coverage.map_or_else(String::new, |share| format!(", {} mapped", percent(share)));
        format!("frame {}{mapped}", shot.row.frame)
    }
}

fn draw_frame(canvas: &mut Canvas, row: &SheetRow, top: i64) {
    canvas.text(GAP, top, "camera", Font::Label, FAINT);
    draw_pixels(canvas, row, top + LABEL, |index, _, _| row.rgb[index].map(without_noise));
}

fn draw_depth(canvas: &mut Canvas, row: &SheetRow, scale: &DepthScale, top: i64) {
    let (depth, label) = match (&row.network, &row.dense) {
        (Some(network), _) => (Some(network), "network depth"),
        (None, Some(dense)) => (Some(dense), "dense depth"),
        (None, None) => (row.coarse.as_ref(), "coarse depth"),
    };
    canvas.text(GAP, top, label, Font::Label, FAINT);
    draw_pixels(canvas, row, top + LABEL, |index, x, y| {
        let depth_m = depth.map_or(0.0, |depth| depth.depth_m[index]);
        scale.color_of(depth_m).unwrap_or_else(|| hatch(x, y)).map(without_noise)
    });
}

fn draw_pixels(
    canvas: &mut Canvas,
    row: &SheetRow,
    top: i64,
    color: impl Fn(usize, i64, i64) -> Rgb,
) {
    for index in 0..row.width * row.height {
        let x = GAP + (index % row.width) as i64;
        let y = top + (index / row.width) as i64;
        canvas.blend(x, y, color(index, x, y), 1.0);
    }
}

/// One of 32 levels: the sensor's noise, which cannot be compressed, is smaller than a level.
fn without_noise(channel: u8) -> u8 {
    (channel & 0xf8) + 4
}

/// The map with the path up to a moment.
struct MapPanel<'a> {
    cells: Cells<'a, CellState>,
    path: &'a [Pose2],
    left: i64,
    width: i64,
    height: i64,
    pixels_per_m: f64,
}

impl<'a> MapPanel<'a> {
    fn new(animation: &Animation<'a>, shot: &'a Shot, left: i64) -> Self {
        let width = animation.map_width.max(1);
        let side_m = animation.resolution_m * width.max(shot.cells.len() / width) as f64;
        let pixels_per_m = MAP_SIDE / side_m.max(animation.resolution_m);
        let pixels =
            |cells: usize| (cells as f64 * animation.resolution_m * pixels_per_m).round() as i64;
        let until = (shot.row.frame as usize + 1).min(animation.trajectory.len());
        Self {
            cells: Cells {
                width,
                cells: &shot.cells,
                resolution_m: animation.resolution_m,
                origin_m: animation.origin_m,
            },
            path: &animation.trajectory[..until],
            left,
            width: pixels(width),
            height: pixels(shot.cells.len() / width),
            pixels_per_m,
        }
    }

    fn page_width(&self) -> i64 {
        self.left + self.width + GAP
    }

    fn draw(&self, canvas: &mut Canvas) {
        for y in 0..self.height {
            for x in 0..self.width {
                let color = match self.state(x, y) {
                    CellState::Unknown => UNKNOWN,
                    CellState::Free => FREE,
                    CellState::Occupied => OCCUPIED,
                };
                canvas.blend(self.left + x, TITLE + y, color, 1.0);
            }
        }
        canvas.frame(self.left, TITLE, self.width, self.height, FAINT);
        let last = self.path.len().max(2) as f64 - 1.0;
        for (index, pair) in self.path.windows(2).enumerate() {
            let color = colors::time(index as f64 / last);
            canvas.line(self.pixel(&pair[0]), self.pixel(&pair[1]), 2.0, color, 1.0);
        }
        if let Some(robot) = self.path.last() {
            self.draw_robot(canvas, robot);
        }
    }

    fn draw_robot(&self, canvas: &mut Canvas, pose: &Pose2) {
        let at = self.pixel(pose);
        let (sin, cos) = pose.yaw_rad.sin_cos();
        canvas.disc(at, 6.0, PAGE);
        canvas.disc(at, 5.0, END);
        canvas.line(at, [at[0] + 9.0 * cos, at[1] - 9.0 * sin], 2.0, INK, 1.0);
    }

    fn state(&self, x: i64, y: i64) -> CellState {
        let right_m = (x as f64 + 0.5) / self.pixels_per_m;
        let up_m = ((self.height - y) as f64 - 0.5) / self.pixels_per_m;
        let [x_m, y_m] = self.cells.origin_m;
        self.cells.get(x_m + right_m, y_m + up_m).unwrap_or(CellState::Unknown)
    }

    fn pixel(&self, pose: &Pose2) -> [f64; 2] {
        let right = (pose.x_m - self.cells.origin_m[0]) * self.pixels_per_m;
        let up = (pose.y_m - self.cells.origin_m[1]) * self.pixels_per_m;
        [self.left as f64 + right - 0.5, (TITLE + self.height) as f64 - up - 0.5]
    }
}

/// Every second image, and always the last one.
fn every_second(images: Vec<Canvas>) -> Vec<Canvas> {
    let last = images.len() - 1;
    images
        .into_iter()
        .enumerate()
        .filter(|(index, _)| (last - index).is_multiple_of(2))
        .map(|(_, image)| image)
        .collect()
}

/// An animated PNG that is repeated for ever.
fn encode(images: &[Canvas], shown: Duration) -> Result<Vec<u8>, EncodingError> {
    let mut bytes = Vec::new();
    let (width, height) = images.first().map_or((1, 1), Canvas::size);
    let mut encoder = Encoder::new(&mut bytes, width, height);
    encoder.set_color(ColorType::Rgb);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_compression(Compression::High);
    encoder.set_animated(images.len() as u32, 0)?;
    let mut writer = encoder.write_header()?;
    for (index, image) in images.iter().enumerate() {
        let time = if index + 1 == images.len() { LAST_SHOWN } else { shown };
        writer.set_frame_delay(time.as_millis() as u16, 1000)?;
        writer.write_image_data(image.bytes())?;
    }
    writer.finish()?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::io::BufReader;

    use super::*;

    const WIDTH: usize = 40;

    /// A map of 40 x 30 cells in which one more row is known in every shot.
    fn shot(frame: u64) -> Shot {
        let cells = (0..WIDTH * 30).map(|index| {
            if index / WIDTH < frame as usize { CellState::Free } else { CellState::Unknown }
        });
        Shot {
            row: SheetRow {
                frame,
                width: 32,
                height: 8,
                rgb: vec![[100, 50, 20]; 32 * 8],
                coarse: None,
                dense: None,
                network: None,
                truth: None,
            },
            cells: cells.collect(),
            coverage: Some(frame as f64 / 30.0),
        }
    }

    fn animation<'a>(shots: &'a [Shot], trajectory: &'a [Pose2]) -> Animation<'a> {
        Animation {
            title: "test",
            shots,
            map_width: WIDTH,
            resolution_m: 0.1,
            trajectory,
            origin_m: [-1.0, -1.0],
            scale: DepthScale::of(shots.iter().map(|shot| &shot.row)),
        }
    }

    /// Images of a file with the time for which each is shown, milliseconds.
    fn images(path: &Path) -> Vec<(u16, Vec<u8>)> {
        let mut reader =
            png::Decoder::new(BufReader::new(File::open(path).unwrap())).read_info().unwrap();
        let count = reader.info().animation_control().unwrap().num_frames;
        (0..count)
            .map(|_| {
                let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
                reader.next_frame(&mut pixels).unwrap();
                let delay = reader.info().frame_control().unwrap();
                assert_eq!(delay.delay_den, 1000);
                (delay.delay_num, pixels)
            })
            .collect()
    }

    #[test]
    fn every_shot_is_an_image_in_which_the_map_has_grown() {
        let dir = tempfile::tempdir().unwrap();
        let shots: Vec<Shot> = (0..6).map(|index| shot(5 * index)).collect();
        let path: Vec<Pose2> = (0..26).map(|i| Pose2::new(0.05 * f64::from(i), 0.0, 0.0)).collect();
        animation(&shots, &path).write(dir.path()).unwrap();
        let images = images(&dir.path().join(ANIMATION_FILE));
        assert_eq!(images.len(), 6);
        let free: Vec<usize> = images
            .iter()
            .map(|(_, pixels)| pixels.chunks_exact(3).filter(|pixel| **pixel == FREE).count())
            .collect();
        assert!(free.windows(2).all(|pair| pair[1] > pair[0] + 1000), "{free:?}");
        assert_eq!((images[0].0, images[5].0), (100, 2500), "the last image stays");
    }

    #[test]
    fn an_animation_that_is_too_large_loses_every_second_image_but_never_the_last() {
        assert_eq!(widths_left_of(5), [1, 3, 5]);
        assert_eq!(widths_left_of(4), [2, 4]);
        assert_eq!(widths_left_of(1), [1]);
    }

    /// The widths of the images that remain of `count` images, which are 1, 2, 3 and more pixels wide.
    fn widths_left_of(count: u32) -> Vec<u32> {
        let images = (1..=count).map(|width| Canvas::new(width, 1, PAGE)).collect();
        every_second(images).iter().map(|image| image.size().0).collect()
    }

    #[test]
    fn noise_of_any_strength_fits_into_the_largest_file() {
        let dir = tempfile::tempdir().unwrap();
        let mut seed = 1_u32;
        let shots: Vec<Shot> = (0..SHOTS).map(|frame| noisy(frame, &mut seed)).collect();
        animation(&shots, &[]).write(dir.path()).unwrap();
        let path = dir.path().join(ANIMATION_FILE);
        assert!(std::fs::metadata(&path).unwrap().len() <= MAX_BYTES as u64);
        let kept = images(&path);
        assert!(kept.len() >= 15 && kept.len() < SHOTS as usize, "{}", kept.len());
        assert!(kept[0].0 >= 200, "shown for longer instead");
    }

    fn noisy(frame: u64, seed: &mut u32) -> Shot {
        let mut shot = shot(frame);
        shot.row.width = 320;
        shot.row.height = 96;
        let pixels = (0..320 * 96).map(|_| {
            *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let [r, g, b, _] = seed.to_be_bytes();
            [r, g, b]
        });
        shot.row.rgb = pixels.collect();
        shot
    }

    #[test]
    fn without_shots_there_is_no_file() {
        let dir = tempfile::tempdir().unwrap();
        animation(&[], &[]).write(dir.path()).unwrap();
        assert!(!dir.path().join(ANIMATION_FILE).exists());
    }
}
