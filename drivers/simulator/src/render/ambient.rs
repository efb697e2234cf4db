//! Bakes ambient light for scenes that come without it: how much of its surroundings each triangle
//! corner sees.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::bvh::{Bvh, Corners, V3};
use super::surface::Surface;
use crate::scene::{Scene, Triangle, Vertex};

/// The options of [`bake_ambient`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AmbientOptions {
    /// Maximum number of rays from each sample point.
    pub rays: usize,
    /// Total number of rays. With more sample points each gets fewer rays, but at least 8. This
    /// bounds the run time.
    pub rays_in_all: usize,
    /// Surfaces farther away than this do not occlude, metres.
    pub reach_m: f32,
    /// Ambient light at a fully occluded point, 0 to 1.
    pub darkest: f32,
    /// Triangles with longer edges are divided, metres, so that a wall of two triangles can be
    /// darker only in its corners.
    pub longest_edge_m: f32,
    /// Dividing stops before the scene has more triangles than this.
    pub most_triangles: usize,
}

impl Default for AmbientOptions {
    fn default() -> Self {
        Self {
            rays: 24,
            rays_in_all: 2_000_000,
            reach_m: 1.2,
            darkest: 0.35,
            longest_edge_m: 0.5,
            most_triangles: 400_000,
        }
    }
}

/// Sets every corner's [`Vertex::ambient`] by casting rays (ambient occlusion; Zhukov et al., "An
/// ambient light illumination model", 1998), after dividing long triangles. Neighbours are divided
/// alike, so no gaps open.
pub fn bake_ambient(scene: &mut Scene, options: &AmbientOptions) {
    divide_long_edges(scene, options);
    let normals: Vec<V3> =
        scene.triangles.iter().map(|t| Surface::new(t).map_or(V3::zeros(), |s| s.normal)).collect();
    let corners: Vec<Corners> = scene
        .triangles
        .iter()
        .zip(&normals)
        .filter(|(_, normal)| **normal != V3::zeros())
        .map(|(t, _)| Corners { points: t.vertices.map(|v| v.position_m.into()), has_holes: false })
        .collect();
    let (bvh, _) = Bvh::build(&corners);
    let places = Places::new(&scene.triangles, &normals);
    let affordable = options.rays_in_all / places.distinct.len().max(1);
    let directions = hemisphere(affordable.max(8).min(options.rays));
    let ambient: Vec<f32> = places
        .distinct
        .par_iter()
        .with_min_len(256)
        .map(|place| place.ambient(&bvh, &directions, options))
        .collect();
    for (triangle, corners) in scene.triangles.iter_mut().zip(places.of_corner.chunks_exact(3)) {
        for (vertex, place) in triangle.vertices.iter_mut().zip(corners) {
            vertex.ambient = ambient[*place as usize];
        }
    }
}

/// A side that is less open than this lies inside an object; the corner of a room is a third open.
const BURIED: f32 = 0.15;
/// A side that is more open than this over a distance of many rooms faces the outside of the world.
const VOID: f32 = 0.999;

/// A sample point on a surface.
#[derive(Debug, Clone, Copy)]
struct Place {
    point: V3,
    normal: V3,
}

/// Corners within this distance share one sample point if their triangles face the same direction
/// to about 15 degrees.
const PLACE_M: f32 = 0.025;

/// Sample points for all corners. Neighbouring corners share a point, which avoids seams.
struct Places {
    distinct: Vec<Place>,
    /// Index into `distinct` for every corner of every triangle.
    of_corner: Vec<u32>,
}

impl Places {
    fn new(triangles: &[Triangle], normals: &[V3]) -> Self {
        let mut keyed: Vec<([i32; 6], u32)> = Vec::with_capacity(triangles.len() * 3);
        for (triangle, normal) in triangles.iter().zip(normals) {
            for vertex in &triangle.vertices {
                let [x, y, z] = vertex.position_m.map(|c| (c / PLACE_M).round() as i32);
                let [a, b, c]: [i32; 3] = normal.map(|c| (c * 4.0).round() as i32).into();
                keyed.push(([x, y, z, a, b, c], keyed.len() as u32));
            }
        }
        keyed.par_sort_unstable();
        let mut places = Self { distinct: Vec::new(), of_corner: vec![0; keyed.len()] };
        let mut last = None;
        for (key, corner) in keyed {
            if last != Some(key) {
                last = Some(key);
                let triangle = corner as usize / 3;
                let vertex = corner as usize % 3;
                places.distinct.push(Place::new(&triangles[triangle], vertex, normals[triangle]));
            }
            places.of_corner[corner as usize] = places.distinct.len() as u32 - 1;
        }
        places
    }
}

impl Place {
    /// Slightly towards the triangle's centre, so that the surface across the edge does not hide
    /// half of the view.
    fn new(triangle: &Triangle, vertex: usize, normal: V3) -> Self {
        let [a, b, c] = triangle.vertices.map(|v| V3::from(v.position_m));
        let corner = [a, b, c][vertex];
        let inwards = (a + b + c) / 3.0 - corner;
        let step = (0.05 / inwards.norm().max(1e-6)).min(0.3);
        Self { point: corner + inwards * step, normal }
    }

    /// Triangles should be wound counter-clockwise as seen from outside, but not every file does
    /// that: a side that faces the void or the inside of an object is not the visible one.
    fn ambient(&self, bvh: &Bvh, directions: &[V3], options: &AmbientOptions) -> f32 {
        if self.normal == V3::zeros() {
            return 1.0;
        }
        let front = self.open_share(self.normal, bvh, directions, options.reach_m);
        let open = if front < BURIED {
            front.max(self.open_share(-self.normal, bvh, directions, options.reach_m))
        } else if front > VOID && self.open_share(self.normal, bvh, directions, 50.0) > VOID {
            self.open_share(-self.normal, bvh, directions, options.reach_m)
        } else {
            front
        };
        options.darkest + (1.0 - options.darkest) * open
    }

    /// Open fraction of the half-space along `normal`, weighted by the cosine. Distant surfaces
    /// occlude less.
    fn open_share(&self, normal: V3, bvh: &Bvh, directions: &[V3], reach_m: f32) -> f32 {
        let side = if normal.x.abs() < 0.7 { V3::x() } else { V3::y() };
        let tangent = normal.cross(&side).normalize();
        let binormal = normal.cross(&tangent);
        let origin = self.point + normal * 2e-3;
        let open: f32 = directions
            .iter()
            .map(|d| {
                let direction = tangent * d.x + binormal * d.y + normal * d.z;
                let hit = bvh.nearest(origin, direction, reach_m, |_, _| true);
                hit.map_or(1.0, |(t, _)| t / reach_m)
            })
            .sum();
        open / directions.len().max(1) as f32
    }
}

/// Directions around z with cosine-weighted density (Malley's method on a Fibonacci spiral).
fn hemisphere(count: usize) -> Vec<V3> {
    const GOLDEN_ANGLE: f32 = 2.399_963_2;
    (0..count)
        .map(|i| {
            let radius_2 = (i as f32 + 0.5) / count as f32;
            let (sin, cos) = (i as f32 * GOLDEN_ANGLE).sin_cos();
            let radius = radius_2.sqrt();
            Vector3::new(radius * cos, radius * sin, (1.0 - radius_2).sqrt())
        })
        .collect()
}

/// Halves edges that are too long until none is left. Whether an edge is halved depends on that
/// edge alone, so both of its triangles agree.
fn divide_long_edges(scene: &mut Scene, options: &AmbientOptions) {
    loop {
        let mut divided = Vec::with_capacity(scene.triangles.len());
        for triangle in &scene.triangles {
            let [a, b, c] = triangle.vertices;
            let long = [
                is_too_long(&a, &b, options),
                is_too_long(&b, &c, options),
                is_too_long(&c, &a, options),
            ];
            divided.extend(
                divide(&triangle.vertices, long).map(|vertices| Triangle { vertices, ..*triangle }),
            );
            if divided.len() > options.most_triangles.max(scene.triangles.len()) {
                return; // this pass would exceed the limit; the result of the last one has no gaps
            }
        }
        if divided.len() == scene.triangles.len() {
            return;
        }
        scene.triangles = divided;
    }
}

fn is_too_long(a: &Vertex, b: &Vertex, options: &AmbientOptions) -> bool {
    (V3::from(a.position_m) - V3::from(b.position_m)).norm() > options.longest_edge_m
}

/// The parts of a triangle whose edges ab, bc, ca are halved where `long` is set.
fn divide([a, b, c]: &[Vertex; 3], long: [bool; 3]) -> impl Iterator<Item = [Vertex; 3]> {
    let ab = middle(a, b);
    let bc = middle(b, c);
    let ca = middle(c, a);
    let a = *a;
    let b = *b;
    let c = *c;
    let parts: [Option<[Vertex; 3]>; 4] = match long {
        [false, false, false] => [Some([a, b, c]), None, None, None],
        [true, false, false] => [Some([a, ab, c]), Some([ab, b, c]), None, None],
        [false, true, false] => [Some([b, bc, a]), Some([bc, c, a]), None, None],
        [false, false, true] => [Some([c, ca, b]), Some([ca, a, b]), None, None],
        [true, true, false] => [Some([a, ab, c]), Some([ab, bc, c]), Some([ab, b, bc]), None],
        [false, true, true] => [Some([b, bc, a]), Some([bc, ca, a]), Some([bc, c, ca]), None],
        [true, false, true] => [Some([c, ca, b]), Some([ca, ab, b]), Some([ca, a, ab]), None],
        [true, true, true] => {
            [Some([a, ab, ca]), Some([ab, b, bc]), Some([ca, bc, c]), Some([ab, bc, ca])]
        }
    };
    parts.into_iter().flatten()
}

fn middle(a: &Vertex, b: &Vertex) -> Vertex {
    Vertex {
        position_m: std::array::from_fn(|i| (a.position_m[i] + b.position_m[i]) * 0.5),
        uv: std::array::from_fn(|i| (a.uv[i] + b.uv[i]) * 0.5),
        ambient: (a.ambient + b.ambient) * 0.5,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::tests::{plain, room};

    fn furnished() -> Scene {
        Scene {
            triangles: room([4.0, 3.0, 2.5], 0),
            materials: vec![plain([0.5; 3])],
            textures: vec![],
        }
    }

    fn ambient_near(scene: &Scene, point: [f32; 3]) -> f32 {
        let vertices = scene.triangles.iter().flat_map(|t| &t.vertices);
        vertices
            .min_by(|a, b| distance_m(a, point).total_cmp(&distance_m(b, point)))
            .unwrap()
            .ambient
    }

    fn distance_m(vertex: &Vertex, point: [f32; 3]) -> f32 {
        (V3::from(vertex.position_m) - V3::from(point)).norm()
    }

    #[test]
    fn corners_of_a_room_are_darker_than_its_walls() {
        let mut scene = furnished();
        bake_ambient(&mut scene, &AmbientOptions::default());
        let corner = ambient_near(&scene, [0.0, 0.0, 0.0]);
        let edge = ambient_near(&scene, [2.0, 0.0, 0.0]);
        let floor = ambient_near(&scene, [2.0, 1.5, 0.0]);
        assert!(corner + 0.1 < edge && edge + 0.1 < floor, "{corner} {edge} {floor}");
        assert!(floor > 0.95 && corner >= 0.35);
    }

    #[test]
    fn dividing_keeps_the_area_and_leaves_no_long_edge_and_no_gap() {
        let mut scene = furnished();
        let before = scene_area(&scene);
        divide_long_edges(&mut scene, &AmbientOptions::default());
        assert!((scene_area(&scene) / before - 1.0).abs() < 1e-4);
        let mut edges: Vec<[[i32; 3]; 2]> = Vec::new();
        for triangle in &scene.triangles {
            let points = triangle.vertices.map(|v| v.position_m);
            for (p, q) in [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (points[i], points[j])) {
                assert!((V3::from(p) - V3::from(q)).norm() <= 0.5);
                edges.push(if rounded_point(p) < rounded_point(q) {
                    [rounded_point(p), rounded_point(q)]
                } else {
                    [rounded_point(q), rounded_point(p)]
                });
            }
        }
        // In a closed room every edge belongs to exactly two triangles.
        edges.sort_unstable();
        assert!(edges.chunks(2).all(|pair| pair[0] == pair[1]));
    }

    fn rounded_point(p: [f32; 3]) -> [i32; 3] {
        p.map(|c| (c * 1e4).round() as i32)
    }

    fn scene_area(scene: &Scene) -> f32 {
        scene.triangles.iter().map(triangle_area).sum()
    }

    #[test]
    fn dividing_stops_at_its_limit() {
        let mut scene = furnished();
        divide_long_edges(
            &mut scene,
            &AmbientOptions { most_triangles: 100, ..AmbientOptions::default() },
        );
        assert!((12..=100).contains(&scene.triangles.len()));
    }

    fn triangle_area(t: &Triangle) -> f32 {
        let [a, b, c] = t.vertices.map(|v| V3::from(v.position_m));
        (b - a).cross(&(c - a)).norm() / 2.0
    }

    #[test]
    fn the_baked_light_does_not_depend_on_the_number_of_threads() {
        assert!(baked_on(1) == baked_on(4));
    }

    fn baked_on(threads: usize) -> Scene {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut scene = furnished();
        pool.install(|| bake_ambient(&mut scene, &AmbientOptions::default()));
        scene
    }
}
