//! Lighting and the conversion of linear light to image bytes.

use super::bvh::V3;

/// Lighting of the scene. It depends on the surface only, never on the camera position, so that a
/// point has the same colour in every view.
#[derive(Debug, Clone, PartialEq)]
pub struct Lighting {
    /// Linear-light colour that a surface facing up receives from ceiling lamps and windows.
    pub from_above: [f32; 3],
    /// Linear-light colour that a surface facing down receives: reflections from floor and
    /// furniture. Between up and down, the two are interpolated by the z component of the normal.
    pub from_below: [f32; 3],
    /// Soft light sources at the sides.
    pub windows: Vec<Window>,
    /// Factor on all light.
    pub exposure: f32,
    /// Linear-light colour where a ray hits nothing.
    pub background: [f32; 3],
    /// Patches of sunlight; none by default.
    pub sun: Option<SunPatches>,
}

/// Soft light from one direction, as from a large window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Direction towards the light source in the world frame, of any length.
    pub direction: [f32; 3],
    /// Linear-light colour on a surface that faces it.
    pub color: [f32; 3],
}

/// Sunlight through windows: bright parallelograms in a regular pattern over the whole world,
/// projected along the sun's direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SunPatches {
    /// Linear-light strength on a surface that faces the sun, in multiples of white (1 doubles the
    /// light of a well-lit surface).
    pub strength: f32,
    /// Direction towards the sun in the world frame, of any length, above the horizon.
    pub direction: [f32; 3],
    /// Width and length of a patch on the floor, metres.
    pub size_m: [f32; 2],
    /// Distance between patches on the floor, metres.
    pub spacing_m: f32,
}

impl Default for Lighting {
    /// A bright room: ceiling light, reflections from a wooden floor, a cool window on one side and
    /// a warm lamp on the other.
    fn default() -> Self {
        Self {
            from_above: [0.62, 0.61, 0.58],
            from_below: [0.33, 0.31, 0.28],
            windows: vec![
                Window { direction: [0.8, 0.45, 0.25], color: [0.25, 0.28, 0.31] },
                Window { direction: [-0.35, -0.9, 0.3], color: [0.14, 0.11, 0.08] },
            ],
            exposure: 1.0,
            background: [0.45, 0.49, 0.55],
            sun: None,
        }
    }
}

impl Lighting {
    /// Uniform light on every surface, which shows the textures unchanged.
    #[must_use]
    pub fn flat() -> Self {
        Self {
            from_above: [1.0; 3],
            from_below: [1.0; 3],
            windows: Vec::new(),
            exposure: 1.0,
            background: [0.0; 3],
            sun: None,
        }
    }

    /// Light on a surface with this unit normal, without the sun.
    pub(super) fn on_surface(&self, normal: &V3) -> [f32; 3] {
        let up = 0.5 + 0.5 * normal.z;
        let mut light = [0.0; 3];
        for channel in 0..3 {
            light[channel] = self.from_below[channel]
                + up * (self.from_above[channel] - self.from_below[channel]);
        }
        for window in &self.windows {
            // A quarter of the light wraps around, because a wide source also lights surfaces that
            // face slightly away from it.
            let facing = (0.25 + 0.75 * normal.dot(&unit(window.direction))).max(0.0);
            for channel in 0..3 {
                light[channel] += facing * window.color[channel];
            }
        }
        light.map(|l| l * self.exposure)
    }
}

impl SunPatches {
    /// Sunlight at a point of a surface with this unit normal.
    pub(super) fn at(&self, point: &V3, normal: &V3) -> f32 {
        let sun = unit(self.direction);
        let facing = normal.dot(&sun);
        if facing <= 0.0 || sun.z <= 0.0 {
            return 0.0;
        }
        // Projects the point along the sun's ray onto the floor, then into a cell of the pattern.
        let along = point.z / sun.z;
        let on_floor = [point.x - along * sun.x, point.y - along * sun.y];
        let inside: f32 = (0..2)
            .map(|axis| {
                let cell = (on_floor[axis] / self.spacing_m).rem_euclid(1.0) * self.spacing_m;
                let from_edge = self.size_m[axis] / 2.0 - (cell - self.spacing_m / 2.0).abs();
                (0.5 + from_edge / PENUMBRA_M).clamp(0.0, 1.0)
            })
            .product();
        self.strength * facing * inside
    }
}

/// Width of a patch's soft edge, metres: the sun is half a degree wide, which makes 2 cm at 2.3 m.
const PENUMBRA_M: f32 = 0.02;

fn unit(direction: [f32; 3]) -> V3 {
    V3::from(direction).try_normalize(0.0).unwrap_or_else(V3::z)
}

/// Converts linear light to sRGB bytes: identity up to 0.8, then a soft shoulder that avoids
/// clipped white.
#[derive(Debug)]
pub(super) struct ToneCurve {
    /// Indexed by the square root of light, which resolves dark tones better.
    bytes: Vec<u8>,
}

const CURVE_STEPS: usize = 8192;
const CURVE_MAX_LIGHT: f32 = 4.0;
const SHOULDER: f32 = 0.8;

impl ToneCurve {
    pub fn new() -> Self {
        Self { bytes: (0..CURVE_STEPS).map(curve_byte).collect() }
    }

    #[inline(always)]
    pub fn encode_colour(&self, light: &[f32; 3]) -> [u8; 3] {
        [self.encode(light[0]), self.encode(light[1]), self.encode(light[2])]
    }

    #[inline(always)]
    pub fn encode(&self, light: f32) -> u8 {
        let scale = (CURVE_STEPS - 1) as f32 / CURVE_MAX_LIGHT.sqrt();
        // Signed integers, because their conversions are single instructions.
        let step = (light.max(0.0).sqrt() * scale + 0.5) as i32 as usize;
        self.bytes[step.min(CURVE_STEPS - 1)]
    }
}

fn curve_byte(step: usize) -> u8 {
    let light = CURVE_MAX_LIGHT * (step as f32 / (CURVE_STEPS - 1) as f32).powi(2);
    let headroom = 1.0 - SHOULDER;
    let shown = if light <= SHOULDER {
        light
    } else {
        1.0 - headroom * (-(light - SHOULDER) / headroom).exp()
    };
    linear_to_srgb(shown)
}

/// sRGB transfer function (IEC 61966-2-1).
pub(super) fn srgb_to_linear(byte: u8) -> f32 {
    let s = f32::from(byte) / 255.0;
    if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
}

/// sRGB transfer function (IEC 61966-2-1).
pub(super) fn linear_to_srgb(light: f32) -> u8 {
    let l = light.clamp(0.0, 1.0);
    let s = if l <= 0.003_130_8 { 12.92 * l } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
    (s * 255.0).round() as u8
}
