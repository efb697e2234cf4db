//! The bounding volume hierarchy of a scene's triangles, and single rays through it.

use nalgebra::Vector3;
use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::builder::build_bvh2};

/// Direction or position in the world, metres.
pub(super) type V3 = Vector3<f32>;

/// A box, stored as centre and half extent, which makes the slab test and the plane test shortest.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    pub centre: V3,
    pub half: V3,
    /// First child (the second follows it) or first triangle.
    pub first: u32,
    /// Triangles in a leaf; 0 in an inner node.
    pub count: u32,
}

/// Corners of a triangle and whether parts of it may be holes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corners {
    pub points: [V3; 3],
    pub has_holes: bool,
}

/// The bounding volume hierarchy. Triangles are stored in the order of its leaves.
#[derive(Debug)]
pub(super) struct Bvh {
    pub nodes: Vec<Node>,
    pub triangles: Vec<Corners>,
}

impl Bvh {
    /// Builds the hierarchy. Also returns, for each stored triangle, its index in `triangles`.
    pub fn build(triangles: &[Corners]) -> (Self, Vec<u32>) {
        if triangles.is_empty() {
            return (Self { nodes: Vec::new(), triangles: Vec::new() }, Vec::new());
        }
        let boxes: Vec<Aabb> = triangles
            .iter()
            .map(|t| Aabb::from_points(&t.points.map(|p| <[f32; 3]>::from(p).into())))
            .collect();
        let padded: Vec<Aabb> =
            boxes.iter().map(|b| Aabb::new(b.min - PADDING_M, b.max + PADDING_M)).collect();
        let mut tree = build_bvh2(
            &padded,
            BvhBuildParams::medium_build(),
            &mut std::time::Duration::default(),
        );
        for node in tree.nodes.iter_mut().filter(|node| node.is_leaf()) {
            let range = node.first_index as usize..(node.first_index + node.prim_count) as usize;
            let own = tree.primitive_indices[range].iter().map(|&i| boxes[i as usize]);
            node.set_aabb(own.fold(Aabb::empty(), |all, b| all.union(&b)));
        }
        tree.refit_all();
        let nodes = tree
            .nodes
            .iter()
            .map(|node| {
                let low = V3::from(node.aabb.min.to_array());
                let high = V3::from(node.aabb.max.to_array());
                let centre = (low + high) * 0.5;
                // The margin keeps rounding of the centre from shrinking the box.
                let half = (high - centre).sup(&(centre - low)) + (low.abs() + high.abs()) * 1e-7;
                Node { centre, half, first: node.first_index, count: node.prim_count }
            })
            .collect();
        let order = tree.primitive_indices;
        let triangles = order.iter().map(|&i| triangles[i as usize]).collect();
        (Self { nodes, triangles }, order)
    }

    /// The nearest triangle that the ray hits before `t_max` (in lengths of `direction`) and that
    /// `accept` accepts, with its distance.
    pub fn nearest(
        &self,
        origin: V3,
        direction: V3,
        t_max: f32,
        accept: impl Fn(u32, f32) -> bool,
    ) -> Option<(f32, u32)> {
        let mut best = None;
        self.traverse(origin, direction, t_max, |triangle, t| {
            let taken = accept(triangle, t);
            if taken {
                best = Some((t, triangle));
            }
            if taken { Some(t) } else { None }
        });
        best
    }

    /// Calls `on_hit` for triangles that the ray hits before the limit. `on_hit` may shorten the
    /// limit.
    fn traverse(
        &self,
        origin: V3,
        direction: V3,
        t_max: f32,
        mut on_hit: impl FnMut(u32, f32) -> Option<f32>,
    ) {
        let Some(root) = self.nodes.first() else { return };
        let ray = SlabRay::new(origin, direction);
        let mut limit = t_max;
        let mut stack = [(0_u32, 0.0_f32); STACK];
        let mut height = 0;
        let mut current = (0_u32, ray.entry(root));
        loop {
            if current.1 <= limit {
                let node = &self.nodes[current.0 as usize];
                if node.count == 0 {
                    let left = (node.first, ray.entry(&self.nodes[node.first as usize]));
                    let right = (node.first + 1, ray.entry(&self.nodes[node.first as usize + 1]));
                    let (near, far) = if left.1 <= right.1 { (left, right) } else { (right, left) };
                    if far.1 <= limit {
                        stack[height] = far;
                        height += 1;
                    }
                    current = near;
                    continue;
                }
                for triangle in node.first..node.first + node.count {
                    let corners = &self.triangles[triangle as usize];
                    if let Some(t) = intersect(corners, &origin, &direction)
                        && t <= limit
                        && let Some(shorter) = on_hit(triangle, t)
                    {
                        limit = shorter;
                    }
                }
            }
            if height == 0 {
                return;
            }
            height -= 1;
            current = stack[height];
        }
    }
}

/// Stack size. It exceeds the depth of any tree that the builder makes from f32 coordinates (the
/// builder's own default is 96).
const STACK: usize = 192;

/// Boxes are enlarged by this margin while the hierarchy is built, metres. The surface area
/// heuristic weighs a flat box by its area alone, so on floors and walls of many coplanar triangles
/// all pairings cost the same and the builder pairs badly: rays visited five times as many nodes in
/// a hall of 8 cm tiles.
const PADDING_M: f32 = 0.005;

struct SlabRay {
    origin: V3,
    inverse: V3,
}

impl SlabRay {
    fn new(origin: V3, direction: V3) -> Self {
        // A large finite number instead of 1/0 keeps 0 * infinity out of the slab test.
        let inverse =
            direction.map(|d| if d.abs() < 1e-12 { 1e12_f32.copysign(d) } else { 1.0 / d });
        Self { origin, inverse }
    }

    /// Distance at which the ray enters the box: 0 when it starts inside, infinite when it misses.
    #[inline(always)]
    fn entry(&self, node: &Node) -> f32 {
        let middle = (node.centre - self.origin).component_mul(&self.inverse);
        let reach = node.half.component_mul(&self.inverse.abs());
        let near = middle - reach;
        let far = middle + reach;
        let near = near.x.max(near.y).max(near.z).max(0.0);
        // The margin of a few rounding errors keeps triangles that lie in a face of the box.
        let far = far.x.min(far.y).min(far.z) * (1.0 + 8.0 * f32::EPSILON);
        if near <= far { near } else { f32::INFINITY }
    }
}

/// Distance (in lengths of `direction`) at which a ray hits a triangle from either side.
///
/// The edge functions are bit for bit the negated ones of the neighbouring triangle, so no ray
/// slips through a shared edge (the Plücker-coordinate test of Embree's robust mode).
fn intersect(corners: &Corners, origin: &V3, direction: &V3) -> Option<f32> {
    let [a, b, c] = &corners.points;
    let a = a - origin;
    let b = b - origin;
    let c = c - origin;
    let u = edge(&b, &c).dot(direction);
    let v = edge(&c, &a).dot(direction);
    let w = edge(&a, &b).dot(direction);
    let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
    if !inside {
        return None;
    }
    let normal = (b - a).cross(&(c - a));
    let t = normal.dot(&a) / normal.dot(direction);
    (t >= 0.0 && t.is_finite()).then_some(t)
}

/// Normal of the plane through the origin and an edge, `2 * p x q`. This form is negated exactly
/// when p and q are swapped, and it keeps the precision of a short edge far away.
#[inline(always)]
pub(super) fn edge(p: &V3, q: &V3) -> V3 {
    (p - q).cross(&(p + q))
}
