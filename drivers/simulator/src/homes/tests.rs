//! Properties of every built-in home.

use nalgebra::Vector3;

use super::*;
use crate::scene::{LidarResponse, Triangle};

const SEEDS: u64 = 30;

/// A home without baked light, materials and textures, which take most of the time.
fn unlit(kind: HomeKind, seed: u64, moved: bool) -> (Home, material_set::MaterialSet) {
    let Construction { layout, mesh, materials, furniture } =
        construct(kind, &HomeOptions { moved, ..HomeOptions::new(seed) });
    let (triangles, surfaces) = ambient::triangles(&mesh, &vec![[1.0; 4]; mesh.quads.len()]);
    let scene = Scene { triangles, ..Scene::default() };
    (Home { scene, surfaces, rooms: layout.rooms, doors: layout.doors, furniture }, materials)
}

fn homes(kind: HomeKind) -> impl Iterator<Item = (u64, Home)> {
    (0..SEEDS).map(move |seed| (seed, unlit(kind, seed, false).0))
}

fn digest(home: &Home) -> u64 {
    use std::hash::{DefaultHasher, Hasher};
    let mut hasher = DefaultHasher::new();
    for triangle in &home.scene.triangles {
        hasher.write_u32(triangle.material);
        for v in triangle.vertices {
            let values = v.position_m.iter().chain(&v.uv).chain([&v.ambient]);
            values.for_each(|f| hasher.write_u32(f.to_bits()));
        }
    }
    home.scene.textures.iter().for_each(|t| hasher.write(&t.rgba));
    home.scene.materials.iter().for_each(|m| hasher.write(format!("{m:?}").as_bytes()));
    hasher.finish()
}

#[test]
fn the_same_seed_builds_the_same_bytes_and_another_seed_does_not() {
    for kind in HomeKind::ALL {
        assert_eq!(digest_of(3, kind), digest_of(3, kind), "{kind}");
        assert_ne!(digest_of(3, kind), digest_of(4, kind), "{kind}");
    }
}

fn digest_of(seed: u64, kind: HomeKind) -> u64 {
    digest(&build(kind, &HomeOptions::new(seed)))
}

#[test]
fn every_home_may_have_stairs_down_that_leave_all_else_as_it_is() {
    for kind in HomeKind::ALL {
        for seed in 0..SEEDS {
            let without = construct(kind, &HomeOptions::new(seed));
            let with = construct(kind, &HomeOptions { stairs: true, ..HomeOptions::new(seed) });
            assert_eq!(
                (&without.layout.rooms, without.layout.stairwell),
                (&with.layout.rooms, None)
            );
            assert_eq!(without.layout.doors, with.layout.doors);
            let stairwell = with.layout.stairwell.unwrap_or_else(|| panic!("{kind} {seed}"));
            let opening = stairwell.opening(&with.layout);
            assert!(opening.area_m2() > 1.2, "{kind} {seed}");
            let floor_in_it = with.mesh.quads.iter().filter(|quad| quad.surface == Surface::Floor);
            for quad in floor_in_it {
                let center = [0, 1].map(|i| quad.corners.iter().map(|c| c[i]).sum::<f32>() / 4.0);
                assert!(!opening.contains(center), "{kind} {seed}: floor at {center:?}");
            }
            let lowest = with.mesh.quads.iter().flat_map(|quad| quad.corners.map(|c| c[2]));
            assert!(lowest.fold(0.0, f32::min) < -1.2, "{kind} {seed}");
            for piece in &with.furniture {
                assert!(!piece.rect.overlaps(&opening), "{kind} {seed}: {}", piece.name);
            }
        }
    }
}

#[test]
fn without_cables_a_home_is_the_same_byte_for_byte() {
    for kind in HomeKind::ALL {
        for seed in 0..SEEDS {
            let stairs = seed % 2 == 1;
            let options = HomeOptions { stairs, ..HomeOptions::new(seed) };
            let without = construct(kind, &options);
            let with = construct(kind, &HomeOptions { cables: true, ..options });
            let count = without.mesh.quads.len();
            assert!(with.mesh.quads[..count] == without.mesh.quads[..], "{kind} {seed}");
            assert!(with.mesh.solids == without.mesh.solids, "{kind} {seed}");
            assert_eq!((&with.layout, &with.furniture), (&without.layout, &without.furniture));
            let added = &with.mesh.quads[count..];
            assert!(added.iter().all(|quad| quad.surface == Surface::Cable), "{kind} {seed}");
        }
    }
}

#[test]
fn cables_lie_on_the_floor_of_most_rooms_and_never_over_stairs() {
    let mut rooms = 0;
    let mut with_cables = 0;
    for (kind, seed) in
        HomeKind::ALL.into_iter().flat_map(|kind| (0..SEEDS).map(move |s| (kind, s)))
    {
        let options = HomeOptions { cables: true, stairs: true, ..HomeOptions::new(seed) };
        let home = construct(kind, &options);
        let opening = home.layout.stairwell.map(|stairs| stairs.opening(&home.layout));
        let cables = home.mesh.quads.iter().filter(|quad| quad.surface == Surface::Cable);
        for quad in cables.clone() {
            let rect = home.layout.rooms[usize::from(quad.room)].rect;
            for [x, y, z] in quad.corners {
                assert!(rect.contains([x, y]) && (0.0..=0.008).contains(&z), "{kind} {seed}");
                assert!(!opening.is_some_and(|opening| opening.contains([x, y])), "{kind} {seed}");
            }
        }
        for (index, room) in home.layout.rooms.iter().enumerate() {
            rooms += usize::from(room.kind != RoomKind::Bath);
            with_cables += usize::from(cables.clone().any(|quad| usize::from(quad.room) == index));
        }
    }
    let share = with_cables as f64 / rooms as f64;
    assert!((0.7..0.9).contains(&share), "{share}");
}

#[test]
fn names_of_kinds_are_read_back_and_others_refused() {
    for kind in HomeKind::ALL {
        assert_eq!(kind.to_string().parse(), Ok(kind));
    }
    let error = "castle".parse::<HomeKind>().unwrap_err().to_string();
    assert!(error.contains("castle") && error.contains("office"), "{error}");
}

/// A grid of 5 cm cells. A cell is free where a robot of 0.16 m radius stands at least 0.1 m from
/// everything up to 1.2 m high.
struct Drivable {
    columns: usize,
    origin: [f32; 2],
    free: Vec<bool>,
}

impl Drivable {
    const CELL_M: f32 = 0.05;
    const CLEARANCE_M: f32 = 0.26;

    fn new(home: &Home) -> Self {
        let outer = home.rooms.iter().fold(home.rooms[0].rect, |r, room| Rect {
            min: [r.min[0].min(room.rect.min[0]), r.min[1].min(room.rect.min[1])],
            max: [r.max[0].max(room.rect.max[0]), r.max[1].max(room.rect.max[1])],
        });
        let outer = outer.grown(0.5);
        let [columns, rows] = outer.size().map(|s| (s / Self::CELL_M).ceil() as usize);
        let mut hit = vec![false; columns * rows];
        for triangle in &home.scene.triangles {
            Self::mark(triangle, outer.min, columns, &mut hit);
        }
        let reach = (Self::CLEARANCE_M / Self::CELL_M).ceil() as i64;
        let mut free: Vec<bool> = vec![true; columns * rows];
        for cell in (0..hit.len()).filter(|c| hit[*c]) {
            let x = (cell % columns) as i64;
            let y = (cell / columns) as i64;
            for (dy, dx) in (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| (y, x))) {
                let inside =
                    (0..columns as i64).contains(&(x + dx)) && (0..rows as i64).contains(&(y + dy));
                if inside && ((dx * dx + dy * dy) as f32).sqrt() * Self::CELL_M <= Self::CLEARANCE_M
                {
                    free[((y + dy) * columns as i64 + x + dx) as usize] = false;
                }
            }
        }
        let mut grid = Self { columns, origin: outer.min, free };
        // The area outside of the home does not count as free.
        for cell in 0..grid.free.len() {
            let p = grid.middle(cell);
            let indoors = home.rooms.iter().any(|r| r.rect.contains(p))
                || home.doors.iter().any(|d| d.rect.contains(p));
            grid.free[cell] &= indoors;
        }
        grid
    }

    /// Marks cells that a triangle touches between the floor and 1.2 m.
    fn mark(triangle: &Triangle, origin: [f32; 2], columns: usize, hit: &mut [bool]) {
        let p = triangle.vertices.map(|v| v.position_m);
        let z = [p[0][2].min(p[1][2]).min(p[2][2]), p[0][2].max(p[1][2]).max(p[2][2])];
        if z[1] < 0.02 || z[0] > 1.2 {
            return;
        }
        // Points on the triangle, at most half a cell apart.
        let edges = [(0, 1), (1, 2), (2, 0)];
        let edges = edges.map(|(a, b)| (p[a][0] - p[b][0]).hypot(p[a][1] - p[b][1]));
        let longest = edges[0].max(edges[1]).max(edges[2]);
        let steps = (longest / (Self::CELL_M / 2.0)).ceil().max(1.0) as usize;
        for i in 0..=steps {
            for j in 0..=steps - i {
                let u = i as f32 / steps as f32;
                let v = j as f32 / steps as f32;
                let at: [f32; 3] = std::array::from_fn(|k| {
                    p[0][k] + u * (p[1][k] - p[0][k]) + v * (p[2][k] - p[0][k])
                });
                if (0.02..=1.2).contains(&at[2]) {
                    let cell = [0, 1].map(|k| ((at[k] - origin[k]) / Self::CELL_M) as usize);
                    hit[cell[1] * columns + cell[0]] = true;
                }
            }
        }
    }

    fn middle(&self, cell: usize) -> [f32; 2] {
        let x = cell % self.columns;
        let y = cell / self.columns;
        [
            self.origin[0] + (x as f32 + 0.5) * Self::CELL_M,
            self.origin[1] + (y as f32 + 0.5) * Self::CELL_M,
        ]
    }

    /// Cells that can be reached from a cell, restricted to those that `within` allows and that are
    /// not yet `seen`.
    fn flood(&self, from: usize, seen: &mut [bool], within: impl Fn(usize) -> bool) -> Vec<usize> {
        let mut reached = vec![from];
        seen[from] = true;
        let mut next = 0;
        while next < reached.len() {
            let cell = reached[next];
            next += 1;
            for neighbour in [cell - 1, cell + 1, cell - self.columns, cell + self.columns] {
                if self.free[neighbour] && !seen[neighbour] && within(neighbour) {
                    seen[neighbour] = true;
                    reached.push(neighbour);
                }
            }
        }
        reached
    }

    /// The largest connected free part of a rectangle.
    fn largest_part(&self, rect: &Rect) -> Vec<usize> {
        let mut seen = vec![false; self.free.len()];
        let mut largest = Vec::new();
        for start in 0..self.free.len() {
            if self.free[start] && !seen[start] && rect.contains(self.middle(start)) {
                let part = self.flood(start, &mut seen, |c| rect.contains(self.middle(c)));
                if part.len() > largest.len() {
                    largest = part;
                }
            }
        }
        largest
    }
}

fn assert_all_rooms_connected(kind: HomeKind, moved: bool) {
    for seed in 0..SEEDS {
        let home = unlit(kind, seed, moved).0;
        let grid = Drivable::new(&home);
        let parts: Vec<Vec<usize>> =
            home.rooms.iter().map(|r| grid.largest_part(&r.rect)).collect();
        assert!(!parts[0].is_empty(), "{kind} {seed}: {} is full", home.rooms[0].name);
        let mut seen = vec![false; grid.free.len()];
        grid.flood(parts[0][0], &mut seen, |_| true);
        for (room, part) in home.rooms.iter().zip(&parts) {
            let free_m2 = part.len() as f32 * Drivable::CELL_M.powi(2);
            assert!(
                free_m2 > 0.1 * room.rect.area_m2(),
                "{kind} {seed}: {} has {free_m2} m2 to drive",
                room.name
            );
            assert!(seen[part[0]], "{kind} {seed}: {} cannot be reached", room.name);
        }
    }
}

#[test]
fn a_robot_reaches_every_room_of_an_apartment() {
    assert_all_rooms_connected(HomeKind::Apartment, false);
    assert_all_rooms_connected(HomeKind::Apartment, true);
}

#[test]
fn a_robot_reaches_every_room_of_a_house() {
    assert_all_rooms_connected(HomeKind::House, false);
}

#[test]
fn a_robot_reaches_every_room_of_an_office_also_after_furniture_moved() {
    assert_all_rooms_connected(HomeKind::Office, false);
    assert_all_rooms_connected(HomeKind::Office, true);
}

#[test]
fn sizes_and_counts_are_those_of_real_homes() {
    for (kind, area, rooms) in [
        (HomeKind::Apartment, 40.0..=90.0, 4..=6),
        (HomeKind::House, 85.0..=180.0, 6..=9),
        (HomeKind::Office, 150.0..=300.0, 6..=11),
    ] {
        for (seed, home) in homes(kind) {
            let floor: f32 = home.rooms.iter().map(|r| r.rect.area_m2()).sum();
            assert!(area.contains(&floor), "{kind} {seed}: {floor} m2");
            assert!(rooms.contains(&home.rooms.len()), "{kind} {seed}: {} rooms", home.rooms.len());
            let count = home.scene.triangles.len();
            assert!((15_000..=150_000).contains(&count), "{kind} {seed}: {count} triangles");
            for door in &home.doors {
                assert!(
                    (0.9..=1.1).contains(&door.width_m),
                    "{kind} {seed}: door of {} m",
                    door.width_m
                );
            }
            for room in &home.rooms {
                let shortest = room.rect.size()[0].min(room.rect.size()[1]);
                assert!(shortest > 1.2, "{kind} {seed}: {} is {shortest} m wide", room.name);
                assert!(
                    (2.5..=2.7).contains(&room.height_m),
                    "{kind} {seed}: {} m high",
                    room.height_m
                );
            }
            let furnished = home
                .rooms
                .iter()
                .enumerate()
                .filter(|(i, _)| home.furniture.iter().any(|f| f.room == *i));
            assert!(furnished.count() + 1 >= home.rooms.len(), "{kind} {seed}: empty rooms");
        }
    }
}

#[test]
fn every_triangle_is_sound() {
    for kind in HomeKind::ALL {
        for seed in 0..2 {
            // The second one has cables.
            let cables = seed == 1;
            let home = build(kind, &HomeOptions { cables, ..HomeOptions::new(seed) });
            let scene = &home.scene;
            let bytes: usize = scene.textures.iter().map(|t| t.rgba.len()).sum();
            assert!(bytes <= 40_000_000, "{kind} {seed}: {bytes} bytes of textures");
            assert_eq!(scene.triangles.len(), home.surfaces.len());
            for (triangle, surface) in scene.triangles.iter().zip(&home.surfaces) {
                let material = &scene.materials[triangle.material as usize];
                assert!(
                    material.texture.is_none_or(|t| (t as usize) < scene.textures.len()),
                    "{kind} {seed}"
                );
                let p = triangle.vertices.map(|v| Vector3::from(v.position_m));
                let a = p[1] - p[0];
                let b = p[2] - p[0];
                assert!(
                    a.cross(&b).norm() > 1e-9,
                    "{kind} {seed}: {} is degenerate: {p:?}",
                    material.name
                );
                for v in triangle.vertices {
                    let values = v.position_m.iter().chain(&v.uv).chain([&v.ambient]);
                    assert!(
                        values.into_iter().all(|f| f.is_finite()),
                        "{kind} {seed}: {}: {v:?}",
                        material.name
                    );
                    assert!(
                        (0.0..=1.0).contains(&v.ambient) && v.position_m[2] > -1e-3,
                        "{kind} {seed}: {v:?}"
                    );
                }
                let indoors =
                    home.rooms.iter().any(|r| r.rect.grown(0.13).contains([p[0].x, p[0].y]));
                assert!(
                    indoors || *surface == Surface::Outside,
                    "{kind} {seed}: {} at {p:?}",
                    material.name
                );
            }
            for texture in &scene.textures {
                assert_eq!(texture.rgba.len(), (texture.width * texture.height * 4) as usize);
                assert!(
                    texture.rgba.chunks_exact(4).any(|p| p[..3] != texture.rgba[..3]),
                    "a blank texture"
                );
            }
        }
    }
}

#[test]
fn texture_density_is_the_same_on_every_wall_and_floor() {
    let home = build(HomeKind::House, &HomeOptions::new(2));
    for (triangle, _) in
        home.scene.triangles.iter().zip(&home.surfaces).filter(|(_, s)| is_structure(s))
    {
        let [a, b, c] = triangle.vertices;
        for (v, w) in [(a, b), (b, c), (c, a)] {
            let metres = (Vector3::from(v.position_m) - Vector3::from(w.position_m)).norm();
            let tiles = (v.uv[0] - w.uv[0]).hypot(v.uv[1] - w.uv[1]);
            assert!((1.49..=3.0).contains(&(metres / tiles)), "{} m per texture", metres / tiles);
        }
    }
}

fn is_structure(s: &Surface) -> bool {
    matches!(s, Surface::Wall | Surface::Floor | Surface::Ceiling)
}

#[test]
fn floors_cover_every_room_and_doorway_without_holes() {
    for kind in HomeKind::ALL {
        for (seed, home) in homes(kind).take(6) {
            let floor: Vec<[[f32; 3]; 3]> = home
                .scene
                .triangles
                .iter()
                .map(|t| t.vertices.map(|v| v.position_m))
                .filter(|p| p.iter().all(|p| p[2].abs() < 1e-6))
                .collect();
            for rect in home.rooms.iter().map(|r| r.rect).chain(home.doors.iter().map(|d| d.rect)) {
                let [w, d] = rect.size();
                for i in 0..60 {
                    let [x, y] = [0.618, 0.755].map(|step| (0.5 + step * i as f32).fract());
                    let at = [rect.min[0] + w * x, rect.min[1] + d * y];
                    assert!(is_covered(at, &floor), "{kind} {seed}: no floor at {at:?}");
                }
            }
        }
    }
}

fn is_covered(at: [f32; 2], floor: &[[[f32; 3]; 3]]) -> bool {
    floor.iter().any(|p| {
        let s = [
            side_of_line(p[0], p[1], at),
            side_of_line(p[1], p[2], at),
            side_of_line(p[2], p[0], at),
        ];
        s.iter().all(|s| *s >= -1e-5) || s.iter().all(|s| *s <= 1e-5)
    })
}

fn side_of_line(a: [f32; 3], b: [f32; 3], at: [f32; 2]) -> f32 {
    (b[0] - a[0]) * (at[1] - a[1]) - (at[0] - a[0]) * (b[1] - a[1])
}

#[test]
fn moving_furniture_moves_nothing_else() {
    for kind in HomeKind::ALL {
        for seed in 0..8 {
            let (home, materials) = unlit(kind, seed, false);
            let (moved, materials_moved) = unlit(kind, seed, true);
            // Textures depend only on the materials and the seed.
            assert_eq!(materials, materials_moved, "{kind} {seed}");
            assert_eq!((&home.rooms, &home.doors), (&moved.rooms, &moved.doors), "{kind} {seed}");
            assert!(
                fixed_triangles(&home) == fixed_triangles(&moved),
                "{kind} {seed}: walls differ"
            );
            let stayed = home.furniture.iter().filter(|f| moved.furniture.contains(f)).count();
            assert!(
                stayed * 3 < home.furniture.len(),
                "{kind} {seed}: {stayed} of {}",
                home.furniture.len()
            );
        }
    }
}

/// Material, corners with texture coordinates, and kind of surface of a triangle.
type FixedTriangle = (u32, [([f32; 3], [f32; 2]); 3], Surface);

fn fixed_triangles(home: &Home) -> Vec<FixedTriangle> {
    let triangles = home.scene.triangles.iter().zip(&home.surfaces);
    let kept = triangles.filter(|(_, s)| **s != Surface::Furniture);
    kept.map(|(t, s)| (t.material, t.vertices.map(|v| (v.position_m, v.uv)), *s)).collect()
}

#[test]
fn texture_strength_scales_what_walls_show() {
    let blank = wall_contrast(0.0);
    let calibrated = wall_contrast(HomeOptions::TEXTURE);
    let rich = wall_contrast(1.0);
    assert!(blank < 0.1, "{blank}");
    assert!((3.0..9.0).contains(&calibrated), "{calibrated}");
    assert!(rich > 2.5 * calibrated, "{rich} against {calibrated}");
}

fn wall_contrast(strength: f32) -> f64 {
    let home =
        build(HomeKind::Apartment, &HomeOptions { texture: strength, ..HomeOptions::new(1) });
    let wall = home.scene.materials.iter().find(|m| m.name == "painted wall").unwrap();
    let texture = &home.scene.textures[wall.texture.unwrap() as usize];
    let values: Vec<f64> = texture.rgba.chunks_exact(4).map(|p| f64::from(p[1])).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn some_windows_reach_the_floor_and_some_furniture_is_of_black_lacquer() {
    let homes: Vec<Home> =
        (0..6).map(|seed| build(HomeKind::Apartment, &HomeOptions::new(seed))).collect();
    for (name, below_m) in [("window view", 0.1), ("black lacquer", 0.3)] {
        let with = homes.iter().filter(|home| has_absorbing(home, name, below_m)).count();
        assert!(with >= 2, "{name} in {with} of 6 homes");
    }
}

/// Whether a material that laser scanners miss is in the plane of the scan or below.
fn has_absorbing(home: &Home, name: &str, below_m: f32) -> bool {
    home.scene.triangles.iter().any(|triangle| {
        let material = &home.scene.materials[triangle.material as usize];
        material.name == name
            && material.lidar == LidarResponse::Absorbing
            && triangle.vertices.iter().any(|vertex| vertex.position_m[2] < below_m)
    })
}
