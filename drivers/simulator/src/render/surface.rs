//! Texture coordinates, ambient light and normal of a triangle as functions of the point.

use nalgebra::Vector3;

use super::bvh::V3;
use crate::scene::{Triangle, Vertex};

/// Attributes of a triangle, each linear in the point: `value + gradient . (point - origin)`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surface {
    pub origin: V3,
    /// Unit normal of the triangle.
    pub normal: V3,
    uv: [f32; 2],
    uv_gradient: [V3; 2],
    ambient: f32,
    ambient_gradient: V3,
    pub material: u32,
}

impl Surface {
    /// `None` for a triangle without area or with corners that are not numbers: it is never seen.
    pub fn new(triangle: &Triangle) -> Option<Self> {
        let [a, b, c] = triangle.vertices.each_ref();
        let along = position(b) - position(a);
        let across = position(c) - position(a);
        let normal = along.cross(&across);
        let area_squared = normal.norm_squared();
        if !(area_squared.is_finite() && area_squared > 0.0) {
            return None;
        }
        // Vectors in the plane with dual_b . along = 1 and dual_b . across = 0, and vice versa for
        // dual_c.
        let dual_b = across.cross(&normal) / area_squared;
        let dual_c = normal.cross(&along) / area_squared;
        Some(Self {
            origin: a.position_m.into(),
            normal: (normal / area_squared.sqrt()).cast(),
            uv: a.uv,
            uv_gradient: [
                gradient(a.uv[0], b.uv[0], c.uv[0], &dual_b, &dual_c),
                gradient(a.uv[1], b.uv[1], c.uv[1], &dual_b, &dual_c),
            ],
            ambient: a.ambient,
            ambient_gradient: gradient(a.ambient, b.ambient, c.ambient, &dual_b, &dual_c),
            material: triangle.material,
        })
    }

    /// Texture coordinates at a point; `offset` is the point minus [`Surface::origin`].
    #[inline(always)]
    pub fn uv(&self, offset: &V3) -> [f32; 2] {
        let [du, dv] = self.uv_change(offset);
        [self.uv[0] + du, self.uv[1] + dv]
    }

    /// Change of the texture coordinates along a vector.
    #[inline(always)]
    pub fn uv_change(&self, along: &V3) -> [f32; 2] {
        [self.uv_gradient[0].dot(along), self.uv_gradient[1].dot(along)]
    }

    /// Baked ambient light, 0 to 1.
    #[inline(always)]
    pub fn ambient(&self, offset: &V3) -> f32 {
        (self.ambient + self.ambient_gradient.dot(offset)).clamp(0.0, 1.0)
    }
}

fn gradient(at_a: f32, at_b: f32, at_c: f32, dual_b: &Vector3<f64>, dual_c: &Vector3<f64>) -> V3 {
    let gradient = dual_b * f64::from(at_b - at_a) + dual_c * f64::from(at_c - at_a);
    if gradient.iter().all(|g| g.is_finite()) { gradient.cast() } else { V3::zeros() }
}

/// f64, because gradients of slivers lose all digits in f32.
fn position(v: &Vertex) -> Vector3<f64> {
    Vector3::from(v.position_m).cast::<f64>()
}
