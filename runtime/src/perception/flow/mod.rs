//! Dense optical flow: where every pixel of one picture is in another.
//!
//! Dense Inverse Search (Kroeger et al. 2016): from coarse to fine, patches of the first picture are looked for in the second
//! (`search`), their flows averaged for every pixel (`densify`), and the result refined (`variational`).

mod config;
mod densify;
mod derotated;
mod energy;
mod enlarge;
mod field;
mod plane;
mod predict;
mod pyramid;
mod search;
mod split;
#[cfg(test)]
mod tests;
mod variational;

use hal::{ImageView, PixelFormat};

pub use config::{FlowConfig, FlowError, FlowPreset};
use densify::densify;
pub use derotated::DerotatedFlow;
use enlarge::enlarge;
pub use field::FlowField;
use plane::Plane;
pub use predict::{DepthGuess, predicted_flow};
use pyramid::Pyramid;
use search::{PatchGrid, SearchInput};
use variational::Variational;

/// Side of a patch, pixels.
const PATCH: usize = 8;

/// The engine: all buffers for one size of picture. After the first call it allocates nothing, and its results are the same
/// to the last bit for any number of threads. The work runs in the rayon pool of the caller; called from outside one, handing
/// the work over may allocate a few bytes.
#[derive(Debug)]
pub struct DenseFlow {
    config: FlowConfig,
    width: usize,
    height: usize,
    from: Pyramid,
    to: Pyramid,
    /// From the finest scale that is looked at to the coarsest.
    scales: Vec<Scale>,
    lines: Vec<Vec<[f32; 2]>>,
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
    /// An engine for pictures of `width` x `height`.
    ///
    /// # Errors
    /// An impossible setting, or pictures smaller than a patch.
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
        let scale = |scale| Scale::new(width >> scale, height >> scale, &config);
        Ok(Self {
            width,
            height,
            from: Pyramid::new(width, height, finest, coarsest),
            to: Pyramid::new(width, height, finest, coarsest),
            scales: (finest..=coarsest).map(scale).collect(),
            lines: vec![vec![[0.0; 2]; (width >> finest) + 2]; enlarge::bands(height)],
            result: FlowField::zero(width, height),
            config,
        })
    }

    /// For every pixel of `from`, where it is in `to`. A good `initial` flow (from the last pictures, or
    /// [predicted](predicted_flow)) makes large motion possible; a wrong or NaN one does no harm. Always finite.
    ///
    /// # Errors
    /// Pictures or an initial flow of another size than the engine's, pictures that are neither RGB8 nor GRAY8.
    pub fn flow(
        &mut self,
        from: ImageView<'_>,
        to: ImageView<'_>,
        initial: Option<&FlowField>,
    ) -> Result<&FlowField, FlowError> {
        self.check("the first picture", from)?;
        self.check("the second picture", to)?;
        if let Some(initial) = initial {
            self.check_size("the initial flow", initial.width(), initial.height())?;
        }
        // One way into the pool for the whole work, instead of one for every loop.
        rayon::scope(|_| self.compute(from, to, initial));
        Ok(&self.result)
    }

    fn check(&self, what: &'static str, picture: ImageView<'_>) -> Result<(), FlowError> {
        match picture.format() {
            PixelFormat::Gray8 | PixelFormat::Rgb8 => {
                self.check_size(what, picture.width(), picture.height())
            }
            format => Err(FlowError::Format { what, format }),
        }
    }

    fn check_size(&self, what: &'static str, width: usize, height: usize) -> Result<(), FlowError> {
        FlowError::check_size(what, (width, height), (self.width, self.height))
    }

    fn compute(&mut self, from: ImageView<'_>, to: ImageView<'_>, initial: Option<&FlowField>) {
        rayon::join(|| self.from.fill(from), || self.to.fill(to));
        let finest = self.config.finest_scale;
        for index in (0..self.scales.len()).rev() {
            let (fine, coarse) = self.scales.split_at_mut(index + 1);
            let (from, to) = (&self.from.scales[finest + index], &self.to.scales[finest + index]);
            let starts = Starts {
                coarse: coarse.first(),
                width: from.width / 2,
                initial,
                scale: finest + index,
            };
            fine[index].find(&self.config, from, to, &starts);
        }
        let flow = &self.scales[0].flow;
        enlarge(flow, self.width >> finest, finest, &mut self.lines, &mut self.result);
    }
}

/// The coarsest scale: one that makes motions of a quarter of the picture as small as half a patch, and has room for a patch.
fn coarsest_scale(width: usize, height: usize) -> usize {
    let wanted = (width.max(height) as f32 / (4 * PATCH) as f32).log2().round().max(0.0) as usize;
    wanted.min((width.min(height) / PATCH).ilog2() as usize)
}

impl Scale {
    fn new(width: usize, height: usize, config: &FlowConfig) -> Self {
        let pixels = || vec![0.0; width * height];
        Self {
            along_x: Plane::new(width, height, 0),
            along_y: Plane::new(width, height, 0),
            grid: PatchGrid::new(width, height, config.patch_stride_px),
            flow: [pixels(), pixels()],
            weight: pixels(),
            variational: Variational::new(width, height),
        }
    }

    /// Fills the flow of this scale.
    fn find(&mut self, config: &FlowConfig, from: &Plane, to: &Plane, starts: &Starts<'_>) {
        pyramid::gradients(from, &mut self.along_x, &mut self.along_y);
        let (along_x, along_y) = (&self.along_x, &self.along_y);
        let input = SearchInput {
            from,
            along_x,
            along_y,
            to,
            steps: config.descent_iterations.div_ceil(2),
        };
        match starts.initial {
            None => self.grid.search(input, |x, y| [starts.coarser(x, y)]),
            Some(initial) => {
                self.grid.search(input, |x, y| [starts.coarser(x, y), starts.given(initial, x, y)]);
            }
        }
        densify(&self.grid, from, to, &mut self.flow, &mut self.weight);
        if config.variational_iterations > 0 {
            self.variational.refine(from, to, &mut self.flow, config.variational_iterations);
        }
    }
}

/// What is known before the search of a scale.
struct Starts<'a> {
    coarse: Option<&'a Scale>,
    /// Columns of the coarser scale.
    width: usize,
    initial: Option<&'a FlowField>,
    scale: usize,
}

impl Starts<'_> {
    /// The coarser scale's flow at the middle of a patch; zero at the coarsest.
    fn coarser(&self, x: usize, y: usize) -> [f32; 2] {
        let Some(coarse) = self.coarse else { return [0.0; 2] };
        let (width, height) = (self.width, coarse.flow[0].len() / self.width);
        let place = |first: usize, end: usize| {
            let at = ((first + PATCH / 2) as f32 / 2.0 - 0.5).clamp(0.0, (end - 1) as f32);
            (at as usize, (at as usize + 1).min(end - 1), at - at.floor())
        };
        let ((left, right, tx), (top, bottom, ty)) = (place(x, width), place(y, height));
        std::array::from_fn(|component| {
            let flow = &coarse.flow[component];
            let line = |y: usize| plane::lerp(flow[y * width + left], flow[y * width + right], tx);
            2.0 * plane::lerp(line(top), line(bottom), ty)
        })
    }

    /// The initial flow at the middle of a patch; where there is none (or one that leaves any picture), as without.
    fn given(&self, initial: &FlowField, x: usize, y: usize) -> [f32; 2] {
        let (column, row) = ((x + PATCH / 2) << self.scale, (y + PATCH / 2) << self.scale);
        let flow = initial.values()
            [row.min(initial.height() - 1) * initial.width() + column.min(initial.width() - 1)];
        let most = (initial.width() + initial.height()) as f32;
        if flow.iter().all(|value| value.abs() <= most) {
            flow.map(|value| value / (1 << self.scale) as f32)
        } else {
            self.coarser(x, y)
        }
    }
}
