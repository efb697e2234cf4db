//! Flow between pictures whose relative rotation is known: the second picture is turned back first, so that only what the
//! translation moves has to be looked for.

use hal::{CameraModel, ImageView, PixelFormat};
use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::predict::displacement;
use super::{DenseFlow, FlowConfig, FlowError, FlowField};

/// [`DenseFlow`] on derotated pictures. Allocates nothing after the first call, as that.
#[derive(Debug)]
pub struct DerotatedFlow {
    camera: CameraModel,
    engine: DenseFlow,
    /// The second picture as it would look from its place with the first picture's orientation, one byte a pixel.
    turned: Vec<u8>,
    result: FlowField,
}

impl DerotatedFlow {
    /// An engine for pictures of `camera`, whose distortion it ignores.
    ///
    /// # Errors
    /// As [`DenseFlow::new`].
    pub fn new(config: impl Into<FlowConfig>, camera: CameraModel) -> Result<Self, FlowError> {
        let (width, height) = (camera.width, camera.height);
        Ok(Self {
            camera,
            engine: DenseFlow::new(config, width, height)?,
            turned: vec![0; width * height],
            result: FlowField::zero(width, height),
        })
    }

    /// For every pixel of `from`, where it is in `to`; `to_from` turns directions of the first camera into the second. NaN
    /// where the turn leaves nothing in front of the second camera.
    ///
    /// # Errors
    /// As [`DenseFlow::flow`].
    pub fn flow(
        &mut self,
        from: ImageView<'_>,
        to: ImageView<'_>,
        to_from: &UnitQuaternion<f64>,
    ) -> Result<&FlowField, FlowError> {
        self.engine.check("the second picture", to)?;
        let (camera, width) = (self.camera, self.camera.width);
        let rotation = to_from.to_rotation_matrix();
        let turn = |x: f64, y: f64| rotation * camera.ray(x, y);
        self.turned.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, out) in row.iter_mut().enumerate() {
                *out = grey_at(to, &camera, turn(x as f64, y as f64));
            }
        });
        let turned = ImageView::new(width, camera.height, PixelFormat::Gray8, &self.turned);
        // The buffer was made for this size.
        let turned = turned.map_err(|_| FlowError::Format {
            what: "the turned picture",
            format: PixelFormat::Gray8,
        })?;
        let flow = self.engine.flow(from, turned, None)?;
        let rows =
            self.result.values_mut().par_chunks_mut(width).zip(flow.values().par_chunks(width));
        rows.enumerate().for_each(|(y, (out, flow))| {
            for (x, (out, [dx, dy])) in out.iter_mut().zip(flow).enumerate() {
                let (u, v) = (x as f64, y as f64);
                *out = displacement(&camera, (u, v), turn(u + f64::from(*dx), v + f64::from(*dy)));
            }
        });
        Ok(&self.result)
    }
}

/// The grey level of a picture in a direction, between pixels; outside, that of the nearest edge.
fn grey_at(picture: ImageView<'_>, camera: &CameraModel, direction: Vector3<f64>) -> u8 {
    let Some((x, y)) = camera.project(&direction.into()) else { return 0 };
    let (right, bottom) = (picture.width() - 1, picture.height() - 1);
    let (x, y) = (x.clamp(0.0, right as f64), y.clamp(0.0, bottom as f64));
    let (column, row) = (x as usize, y as usize);
    let (fx, fy) = ((x - column as f64) as f32, (y - row as f64) as f32);
    let at = |column: usize, row: usize| {
        let index = row.min(bottom) * picture.width() + column.min(right);
        match picture.format() {
            PixelFormat::Gray8 => f32::from(picture.data()[index]),
            _ => super::pyramid::luma(&picture.data()[3 * index..][..3]),
        }
    };
    let line = |row: usize| super::plane::lerp(at(column, row), at(column + 1, row), fx);
    (super::plane::lerp(line(row), line(row + 1), fy) + 0.5) as u8
}
