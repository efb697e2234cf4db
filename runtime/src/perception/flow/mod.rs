//! Dense optical flow: where every pixel of one image is in another.
//!
//! Dense Inverse Search (Kroeger et al. 2016): from coarse to fine, patches of the first image are searched for in the second
//! (`search`), their flows averaged for every pixel (`densify`), and the result refined (`variational`).

mod config;
mod densify;
mod energy;
mod field;
mod plane;
mod pyramid;
mod search;
mod split;
#[cfg(test)]
mod tests;
mod upsample;
mod variational;

use hal::{ImageView, PixelFormat};

pub use config::{FlowConfig, FlowError, FlowPreset};
use densify::densify;
pub use field::FlowField;
use plane::{Plane, lerp};
use pyramid::Pyramid;
use search::{PatchGrid, SearchInput};
use upsample::upsample;
use variational::Variational;

/// Side of a patch, pixels.
const PATCH: usize = 8;

/// Computes flow, with all buffers for one image size. After the first call it allocates nothing, and its results are the
/// same to the last bit for any number of threads. The work runs in the caller's rayon pool; called from outside a pool, the
/// handover to it may allocate a few bytes.
#[derive(Debug)]
pub struct DenseFlow {
    config: FlowConfig,
    width: usize,
    height: usize,
    from: Pyramid,
    to: Pyramid,
    /// The scales, from the finest that is searched to the coarsest.
    scales: Vec<Scale>,
    /// One row of scratch memory for each band of `upsample`.
    rows: Vec<Vec<[f32; 2]>>,
    result: FlowField,
}

/// The buffers of one scale.
#[derive(Debug)]
struct Scale {
    along_x: Plane,
    along_y: Plane,
    grid: PatchGrid,
    /// x and y, row-major, pixels of this scale.
    flow: [Vec<f32>; 2],
    weight: Vec<f32>,
    variational: Variational,
}

impl DenseFlow {
    /// Prepares flow between images of `width` x `height`.
    ///
    /// # Errors
    /// A setting out of range, or images smaller than a patch.
    pub fn new(
        config: impl Into<FlowConfig>,
        width: usize,
        height: usize,
    ) -> Result<Self, FlowError> {
        let config = config.into();
        config.validate()?;
        let least = width.min(height);
        if least < PATCH {
            return Err(FlowError::Setting {
                field: "width or height",
                value: least,
                allowed: "8 or more",
            });
        }
        let coarsest = coarsest_scale(width, height);
        let finest = config.finest_scale.min(coarsest);
        let config = FlowConfig { finest_scale: finest, ..config };
        Ok(Self {
            width,
            height,
            from: Pyramid::new(width, height, finest, coarsest),
            to: Pyramid::new(width, height, finest, coarsest),
            scales: (finest..=coarsest)
                .map(|scale| Scale::new(width >> scale, height >> scale, &config))
                .collect(),
            rows: vec![vec![[0.0; 2]; (width >> finest) + 2]; upsample::bands(height)],
            result: FlowField::zero(width, height),
            config,
        })
    }

    /// Computes for every pixel of `from` its displacement to `to`, pixels. The result is always finite.
    ///
    /// # Errors
    /// Images of another size than this was made for, or images that are neither RGB8 nor GRAY8.
    pub fn flow(
        &mut self,
        from: ImageView<'_>,
        to: ImageView<'_>,
    ) -> Result<&FlowField, FlowError> {
        self.check("the first image", from)?;
        self.check("the second image", to)?;
        // One entry into the pool for the whole work, instead of one for every loop.
        rayon::scope(|_| self.compute(from, to));
        Ok(&self.result)
    }

    fn check(&self, what: &'static str, image: ImageView<'_>) -> Result<(), FlowError> {
        match image.format() {
            PixelFormat::Gray8 | PixelFormat::Rgb8 => FlowError::check_size(
                what,
                (image.width(), image.height()),
                (self.width, self.height),
            ),
            format => Err(FlowError::Format { what, format }),
        }
    }

    fn compute(&mut self, from: ImageView<'_>, to: ImageView<'_>) {
        rayon::join(|| self.from.fill(from), || self.to.fill(to));
        let finest = self.config.finest_scale;
        for index in (0..self.scales.len()).rev() {
            let (fine, coarse) = self.scales.split_at_mut(index + 1);
            let from = &self.from.scales[finest + index];
            let to = &self.to.scales[finest + index];
            let coarser = coarse.first().map(|scale| CoarserFlow {
                flow: &scale.flow,
                width: from.width / 2,
                height: scale.flow[0].len() / (from.width / 2),
            });
            fine[index].compute(&self.config, from, to, coarser);
        }
        let flow = &self.scales[0].flow;
        upsample(flow, self.width >> finest, finest, &mut self.rows, &mut self.result);
    }
}

/// The coarsest scale: one that makes motions of a quarter of the image as small as half a patch, and is large enough for a
/// patch.
fn coarsest_scale(width: usize, height: usize) -> usize {
    let desired = (width.max(height) as f32 / (4 * PATCH) as f32).log2().round().max(0.0) as usize;
    desired.min((width.min(height) / PATCH).ilog2() as usize)
}

impl Scale {
    fn new(width: usize, height: usize, config: &FlowConfig) -> Self {
        let pixels = width * height;
        Self {
            along_x: Plane::new(width, height, 0),
            along_y: Plane::new(width, height, 0),
            grid: PatchGrid::new(width, height, config.patch_stride_px),
            flow: [vec![0.0; pixels], vec![0.0; pixels]],
            weight: vec![0.0; pixels],
            variational: Variational::new(width, height),
        }
    }

    /// Fills the flow of this scale.
    fn compute(
        &mut self,
        config: &FlowConfig,
        from: &Plane,
        to: &Plane,
        coarser: Option<CoarserFlow<'_>>,
    ) {
        pyramid::gradients(from, &mut self.along_x, &mut self.along_y);
        let input = SearchInput {
            from,
            along_x: &self.along_x,
            along_y: &self.along_y,
            to,
            steps: config.descent_iterations.div_ceil(2),
        };
        self.grid.search(input, |x, y| coarser.map_or([0.0; 2], |coarser| coarser.at_patch(x, y)));
        densify(&self.grid, from, to, &mut self.flow, &mut self.weight);
        if config.variational_iterations > 0 {
            self.variational.refine(from, to, &mut self.flow, config.variational_iterations);
        }
    }
}

/// The flow of the next coarser scale, from which the search of a scale starts.
#[derive(Clone, Copy)]
struct CoarserFlow<'a> {
    flow: &'a [Vec<f32>; 2],
    width: usize,
    height: usize,
}

impl CoarserFlow<'_> {
    /// The flow at the middle of the patch with first column `x` and first row `y`, in pixels of the finer scale.
    fn at_patch(&self, x: usize, y: usize) -> [f32; 2] {
        let (left, right, tx) = neighbours(x, self.width);
        let (top, bottom, ty) = neighbours(y, self.height);
        std::array::from_fn(|component| {
            let flow = &self.flow[component];
            let upper = &flow[top * self.width..];
            let lower = &flow[bottom * self.width..];
            let above = lerp(upper[left], upper[right], tx);
            let below = lerp(lower[left], lower[right], tx);
            2.0 * lerp(above, below, ty)
        })
    }
}

/// The two pixels of the coarser scale (of `size` pixels) around the middle of a patch that begins at `first`, and how far the
/// middle is from one to the other, 0 to 1.
fn neighbours(first: usize, size: usize) -> (usize, usize, f32) {
    let at = ((first + PATCH / 2) as f32 / 2.0 - 0.5).clamp(0.0, (size - 1) as f32);
    (at as usize, (at as usize + 1).min(size - 1), at - at.floor())
}
