//! Finds the nearest surface of every pixel of a block.
//!
//! All rays of an image start at one point, so a block of rays is a thin pyramid, and a triangle's
//! edge functions and its inverse depth are affine in the pixel's column and row (homogeneous
//! rasterisation: Olano and Greer, "Triangle scan conversion using 2D homogeneous coordinates",
//! 1997). A block traverses the hierarchy once, front to back, and skips boxes beside the pyramid
//! or behind surfaces that it has found. The result is the same as that of one ray per pixel.

use super::bvh::{Bvh, Corners, Node, V3, edge};

/// Side of a block, pixels: one row fits two SSE or NEON registers.
pub(super) const SIZE: usize = 8;

pub(super) const NOTHING: u32 = u32::MAX;

/// Surfaces farther away are not seen, metres.
pub(super) const FAR_M: f32 = 200.0;

/// The rays of an image: the ray of pixel (u, v) goes from `origin` along `corner + u * column + v
/// * row`, which has a depth of 1 m.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    pub origin: V3,
    pub corner: V3,
    pub column: V3,
    pub row: V3,
    pub forward: V3,
}

impl View {
    /// The ray direction of a pixel, with a depth of 1 m.
    #[inline(always)]
    pub fn direction(&self, u: f32, v: f32) -> V3 {
        self.corner + self.column * u + self.row * v
    }
}

/// The nearest surface of every pixel of a block.
#[derive(Debug)]
pub(super) struct Block {
    /// 1 / z-depth, 1/m, row by row.
    pub inverse_depth: [[f32; SIZE]; SIZE],
    /// Index of the triangle, or [`NOTHING`].
    pub triangle: [[u32; SIZE]; SIZE],
}

impl Block {
    /// The inverse depth of the farthest pixel. Columns are reduced side by side in vector registers.
    #[inline(always)]
    fn least_inverse_depth(&self) -> f32 {
        let least = |a: f32, b: f32| if b < a { b } else { a };
        let [first, rows @ ..] = &self.inverse_depth;
        let mut columns = *first;
        for row in rows {
            for column in 0..SIZE {
                columns[column] = least(columns[column], row[column]);
            }
        }
        columns.into_iter().fold(f32::INFINITY, least)
    }
}

/// Finds the nearest triangle of every pixel of the block whose first pixel is (`left`, `top`).
/// `is_hole` is called for triangles that may have holes, with the triangle and the point relative
/// to the view's origin.
#[inline(always)]
pub(super) fn nearest_surfaces(
    bvh: &Bvh,
    view: &View,
    (left, top): (usize, usize),
    stack: &mut Vec<(u32, f32)>,
    is_hole: impl Fn(u32, &V3) -> bool,
) -> Block {
    let mut block =
        Block { inverse_depth: [[1.0 / FAR_M; SIZE]; SIZE], triangle: [[NOTHING; SIZE]; SIZE] };
    let Some(root) = bvh.nodes.first() else { return block };
    let pyramid = Pyramid::new(view, left as f32, top as f32);
    let Some(entry) = pyramid.entry(root) else { return block };
    let first = view.direction(left as f32, top as f32);
    let mut limit = FAR_M;
    stack.clear();
    stack.push((0, entry));
    while let Some((index, near)) = stack.pop() {
        if near > limit {
            continue;
        }
        let node = &bvh.nodes[index as usize];
        if node.count > 0 {
            for triangle in node.first..node.first + node.count {
                let corners = &bvh.triangles[triangle as usize];
                let Some(planes) = Planes::new(corners, view, &first, 1.0 / limit) else {
                    continue;
                };
                if corners.has_holes {
                    planes.draw_with_holes(triangle, &mut block, |u, v, depth| {
                        is_hole(triangle, &((first + view.column * u + view.row * v) * depth))
                    });
                } else {
                    planes.draw(triangle, &mut block);
                }
            }
            limit = 1.0 / block.least_inverse_depth();
            continue;
        }
        let a = node.first;
        let b = node.first + 1;
        match (pyramid.entry(&bvh.nodes[a as usize]), pyramid.entry(&bvh.nodes[b as usize])) {
            (Some(near_a), Some(near_b)) if near_a <= near_b => {
                stack.extend([(b, near_b), (a, near_a)]);
            }
            (Some(near_a), Some(near_b)) => stack.extend([(a, near_a), (b, near_b)]),
            (Some(near), None) => stack.push((a, near)),
            (None, Some(near)) => stack.push((b, near)),
            (None, None) => {}
        }
    }
    block
}

/// The four side planes of the block's view pyramid, one per lane. They lie half a pixel outside of
/// the outermost rays.
struct Pyramid {
    origin: V3,
    forward: V3,
    forward_extent: V3,
    inward: [[f32; 4]; 3],
    extent: [[f32; 4]; 3],
}

impl Pyramid {
    fn new(view: &View, left: f32, top: f32) -> Self {
        let right = left + SIZE as f32 - 0.5;
        let bottom = top + SIZE as f32 - 0.5;
        let left = left - 0.5;
        let top = top - 0.5;
        let corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
            .map(|(u, v)| view.direction(u, v));
        let sides: [V3; 4] = std::array::from_fn(|i| {
            let normal = corners[i].cross(&corners[(i + 1) % 4]);
            // The normal points towards the opposite corner, for any orientation of the axes.
            if normal.dot(&corners[(i + 2) % 4]) < 0.0 { -normal } else { normal }
        });
        let inward = std::array::from_fn(|axis| sides.map(|side| side[axis]));
        let extent = inward.map(|lanes| lanes.map(f32::abs));
        let forward_extent = view.forward.abs();
        Self { origin: view.origin, forward: view.forward, forward_extent, inward, extent }
    }

    /// Smallest z-depth of a box, or `None` when it is beside the pyramid or behind the camera.
    #[inline(always)]
    fn entry(&self, node: &Node) -> Option<f32> {
        let centre = node.centre - self.origin;
        let half = node.half;
        let [nx, ny, nz] = &self.inward;
        let [ex, ey, ez] = &self.extent;
        // Distance of the box's innermost corner inside each plane.
        let mut inside = [0.0; 4];
        for side in 0..4 {
            inside[side] = (centre.x * nx[side] + centre.y * ny[side] + centre.z * nz[side])
                + (half.x * ex[side] + half.y * ey[side] + half.z * ez[side]);
        }
        let inside = inside[0].min(inside[1]).min(inside[2].min(inside[3]));
        let middle = centre.dot(&self.forward);
        let reach = half.dot(&self.forward_extent);
        (inside >= 0.0 && middle + reach > 0.0).then_some((middle - reach).max(0.0))
    }
}

const COLUMNS: [f32; SIZE] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
/// Distance from the first to the last pixel of a block.
const SPAN: f32 = (SIZE - 1) as f32;

#[inline(always)]
fn positive(value: f32) -> f32 {
    if value > 0.0 { value } else { 0.0 }
}

/// A function that is affine in column and row within the block: value at the first pixel and
/// change along each.
#[derive(Clone, Copy)]
struct Affine {
    first: f32,
    per_column: f32,
    per_row: f32,
}

impl Affine {
    #[inline(always)]
    fn new(normal: &V3, view: &View, first: &V3) -> Self {
        Self {
            first: normal.dot(first),
            per_column: normal.dot(&view.column),
            per_row: normal.dot(&view.row),
        }
    }

    #[inline(always)]
    fn max(&self) -> f32 {
        self.first + SPAN * (positive(self.per_column) + positive(self.per_row))
    }

    /// The value at the first pixel of a row.
    #[inline(always)]
    fn in_row(&self, row: f32) -> f32 {
        self.first + row * self.per_row
    }

    #[inline(always)]
    fn at(&self, column: f32, row: f32) -> f32 {
        self.in_row(row) + column * self.per_column
    }

    /// The largest value in a row, given the value at its first pixel.
    #[inline(always)]
    fn max_of_row(&self, first: f32) -> f32 {
        first + SPAN * positive(self.per_column)
    }
}

/// A triangle in the coordinates of a block: three edge functions, which are not negative inside,
/// and the inverse depth of its plane.
struct Planes {
    edges: [Affine; 3],
    inverse_depth: Affine,
}

impl Planes {
    /// `None` when the triangle cannot be seen in this block nearer than 1 / `least`.
    #[inline(always)]
    fn new(corners: &Corners, view: &View, first: &V3, least: f32) -> Option<Self> {
        let [a, b, c] = &corners.points;
        let a = a - view.origin;
        let b = b - view.origin;
        let c = c - view.origin;
        let normal = (b - a).cross(&(c - a));
        let distance = normal.dot(&a);
        if distance == 0.0 {
            return None; // edge-on
        }
        let inverse_depth = Affine::new(&(normal / distance), view, first);
        if inverse_depth.max() < least {
            return None;
        }
        // The sign makes the edge functions non-negative inside for both windings.
        let sign = if distance < 0.0 { -1.0 } else { 1.0 };
        let function = |p: &V3, q: &V3| Affine::new(&(edge(p, q) * sign), view, first);
        let edges = [function(&b, &c), function(&c, &a), function(&a, &b)];
        if edges[0].max() < 0.0 || edges[1].max() < 0.0 || edges[2].max() < 0.0 {
            return None;
        }
        Some(Self { edges, inverse_depth })
    }

    /// No branches inside a row, so that the compiler vectorises it: eight pixels are two vector
    /// registers.
    #[inline(always)]
    fn draw(&self, triangle: u32, block: &mut Block) {
        let [u, v, w] = &self.edges;
        let inverse = &self.inverse_depth;
        for row in 0..SIZE {
            let down = row as f32;
            let u_row = u.in_row(down);
            let v_row = v.in_row(down);
            let w_row = w.in_row(down);
            if u.max_of_row(u_row) < 0.0 || v.max_of_row(v_row) < 0.0 || w.max_of_row(w_row) < 0.0 {
                continue;
            }
            let inverse_row = inverse.in_row(down);
            let seen = &mut block.inverse_depth[row];
            let nearest = &mut block.triangle[row];
            for column in 0..SIZE {
                let right = COLUMNS[column];
                let u = u_row + right * u.per_column;
                let v = v_row + right * v.per_column;
                let w = w_row + right * w.per_column;
                let depth = inverse_row + right * inverse.per_column;
                let nearer = (u >= 0.0) & (v >= 0.0) & (w >= 0.0) & (depth > seen[column]);
                let mask = u32::from(nearer).wrapping_neg();
                seen[column] =
                    f32::from_bits((depth.to_bits() & mask) | (seen[column].to_bits() & !mask));
                nearest[column] = (triangle & mask) | (nearest[column] & !mask);
            }
        }
    }

    /// Draws a triangle that may have holes. `is_hole` takes column and row in the block, and
    /// z-depth.
    fn draw_with_holes(
        &self,
        triangle: u32,
        block: &mut Block,
        is_hole: impl Fn(f32, f32, f32) -> bool,
    ) {
        for (row, down) in COLUMNS.into_iter().enumerate() {
            for (column, right) in COLUMNS.into_iter().enumerate() {
                let inverse = self.inverse_depth.at(right, down);
                let inside = self.edges.iter().all(|edge| edge.at(right, down) >= 0.0);
                if inside
                    && inverse > block.inverse_depth[row][column]
                    && !is_hole(right, down, 1.0 / inverse)
                {
                    block.inverse_depth[row][column] = inverse;
                    block.triangle[row][column] = triangle;
                }
            }
        }
    }
}
