//! What a block of pixels sees first.
//!
//! All rays of a picture start in one point, so a block of them is a thin pyramid, and a triangle's edge functions and its
//! inverse depth are affine in the pixel's column and row (homogeneous rasterisation: Olano and Greer, "Triangle scan
//! conversion using 2D homogeneous coordinates", 1997). A block walks the hierarchy once, front to back, leaves out boxes
//! beside the pyramid or behind what it has seen, and gets the same surfaces as one ray a pixel would.

use super::bvh::{Bvh, Corners, Node, V3, edge};

/// Columns and rows of a block: two SSE or NEON registers a row.
pub(super) const SIZE: usize = 8;

/// No triangle.
pub(super) const NOTHING: u32 = u32::MAX;

/// Surfaces further away are not seen, metres.
pub(super) const FAR_M: f32 = 200.0;

/// The rays of a picture: pixel (u, v) looks from `origin` along `corner + u * column + v * row`, which is 1 m deep.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    pub origin: V3,
    pub corner: V3,
    pub column: V3,
    pub row: V3,
    pub forward: V3,
}

impl View {
    /// The direction behind a pixel, 1 m deep.
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
    /// Which triangle, or [`NOTHING`].
    pub triangle: [[u32; SIZE]; SIZE],
}

/// Finds the nearest triangle of every pixel of the block whose first pixel is (`left`, `top`). `is_hole` is asked for
/// triangles that may have holes: (triangle, point relative to the view's origin).
pub(super) fn see(
    bvh: &Bvh,
    view: &View,
    (left, top): (usize, usize),
    stack: &mut Vec<(u32, f32)>,
    is_hole: impl Fn(u32, &V3) -> bool,
) -> Block {
    let mut block = Block { inverse_depth: [[1.0 / FAR_M; SIZE]; SIZE], triangle: [[NOTHING; SIZE]; SIZE] };
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
                let Some(planes) = Planes::new(corners, view, &first, 1.0 / limit) else { continue };
                if corners.has_holes {
                    planes.draw_with_holes(triangle, &mut block, |u, v, depth| {
                        is_hole(triangle, &((first + view.column * u + view.row * v) * depth))
                    });
                } else {
                    planes.draw(triangle, &mut block);
                }
            }
            let farthest = block.inverse_depth.iter().flatten().fold(f32::INFINITY, |a, &b| a.min(b));
            limit = 1.0 / farthest;
            continue;
        }
        let children = [node.first, node.first + 1].map(|i| (i, pyramid.entry(&bvh.nodes[i as usize])));
        match children {
            [(a, Some(near_a)), (b, Some(near_b))] => {
                let (front, back) =
                    if near_a <= near_b { ((a, near_a), (b, near_b)) } else { ((b, near_b), (a, near_a)) };
                stack.push(back);
                stack.push(front);
            }
            [(i, Some(near)), (_, None)] | [(_, None), (i, Some(near))] => stack.push((i, near)),
            _ => {}
        }
    }
    block
}

/// The four side planes through the eye and half a pixel outside of the block's outermost rays, one lane each.
struct Pyramid {
    origin: V3,
    forward: V3,
    inward: [[f32; 4]; 3],
}

impl Pyramid {
    fn new(view: &View, left: f32, top: f32) -> Self {
        let (right, bottom) = (left + SIZE as f32 - 0.5, top + SIZE as f32 - 0.5);
        let (left, top) = (left - 0.5, top - 0.5);
        let corners = [(left, top), (right, top), (right, bottom), (left, bottom)].map(|(u, v)| view.direction(u, v));
        let sides: [V3; 4] = std::array::from_fn(|i| {
            let normal = corners[i].cross(&corners[(i + 1) % 4]);
            // Towards the opposite corner, whichever way the axes turn.
            if normal.dot(&corners[(i + 2) % 4]) < 0.0 { -normal } else { normal }
        });
        let inward = std::array::from_fn(|axis| sides.map(|side| side[axis]));
        Self { origin: view.origin, forward: view.forward, inward }
    }

    /// Least z-depth of a box, or `None` when it is beside the pyramid or behind the eye.
    #[inline(always)]
    fn entry(&self, node: &Node) -> Option<f32> {
        let centre = node.centre - self.origin;
        let half = node.half;
        let [nx, ny, nz] = &self.inward;
        let mut inside = true;
        for side in 0..4 {
            let nearest = centre.x * nx[side] + centre.y * ny[side] + centre.z * nz[side];
            let reach = half.x * nx[side].abs() + half.y * ny[side].abs() + half.z * nz[side].abs();
            inside &= nearest + reach >= 0.0;
        }
        let middle = centre.dot(&self.forward);
        let reach = half.dot(&self.forward.abs());
        (inside && middle + reach > 0.0).then_some((middle - reach).max(0.0))
    }
}

/// Affine in column and row within the block: value at the first pixel and its change along each.
#[derive(Clone, Copy)]
struct Affine {
    first: f32,
    per_column: f32,
    per_row: f32,
}

impl Affine {
    #[inline(always)]
    fn new(normal: &V3, view: &View, first: &V3) -> Self {
        Self { first: normal.dot(first), per_column: normal.dot(&view.column), per_row: normal.dot(&view.row) }
    }

    #[inline(always)]
    fn max(&self) -> f32 {
        const SPAN: f32 = (SIZE - 1) as f32;
        self.first + SPAN * (self.per_column.max(0.0) + self.per_row.max(0.0))
    }
}

/// A triangle as the block sees it: three edge functions, not negative inside, and the inverse depth of its plane.
struct Planes {
    edges: [Affine; 3],
    inverse_depth: Affine,
}

impl Planes {
    /// `None` when the triangle cannot be seen in this block nearer than 1 / `least`.
    #[inline(always)]
    fn new(corners: &Corners, view: &View, first: &V3, least: f32) -> Option<Self> {
        let [a, b, c] = corners.points.map(|p| p - view.origin);
        let normal = (b - a).cross(&(c - a));
        let distance = normal.dot(&a);
        if distance == 0.0 {
            return None; // seen from its edge
        }
        let inverse_depth = Affine::new(&(normal / distance), view, first);
        if inverse_depth.max() < least {
            return None;
        }
        let mut edges = [Affine { first: 0.0, per_column: 0.0, per_row: 0.0 }; 3];
        for (affine, (p, q)) in edges.iter_mut().zip([(b, c), (c, a), (a, b)]) {
            let normal = edge(&p, &q);
            *affine = Affine::new(&if distance < 0.0 { -normal } else { normal }, view, first);
            if affine.max() < 0.0 {
                return None;
            }
        }
        Some(Self { edges, inverse_depth })
    }

    #[inline(always)]
    fn draw(&self, triangle: u32, block: &mut Block) {
        for row in 0..SIZE {
            let (inside, inverse) = self.row(row);
            let seen = &mut block.inverse_depth[row];
            let who = &mut block.triangle[row];
            for column in 0..SIZE {
                let nearer = (inside[column] >= 0.0) & (inverse[column] > seen[column]);
                seen[column] = if nearer { inverse[column] } else { seen[column] };
                who[column] = if nearer { triangle } else { who[column] };
            }
        }
    }

    /// `is_hole`: column and row in the block, z-depth.
    fn draw_with_holes(&self, triangle: u32, block: &mut Block, is_hole: impl Fn(f32, f32, f32) -> bool) {
        for row in 0..SIZE {
            let (inside, inverse) = self.row(row);
            for column in 0..SIZE {
                let nearer = inside[column] >= 0.0 && inverse[column] > block.inverse_depth[row][column];
                if nearer && !is_hole(column as f32, row as f32, 1.0 / inverse[column]) {
                    block.inverse_depth[row][column] = inverse[column];
                    block.triangle[row][column] = triangle;
                }
            }
        }
    }

    /// Least edge function and inverse depth of a row's pixels.
    #[inline(always)]
    fn row(&self, row: usize) -> ([f32; SIZE], [f32; SIZE]) {
        let at = |affine: &Affine, column: usize| {
            (affine.first + row as f32 * affine.per_row) + column as f32 * affine.per_column
        };
        let [u, v, w] = &self.edges;
        let inside = std::array::from_fn(|column| {
            let (u, v, w) = (at(u, column), at(v, column), at(w, column));
            let least = if u < v { u } else { v };
            if least < w { least } else { w }
        });
        (inside, std::array::from_fn(|column| at(&self.inverse_depth, column)))
    }
}
