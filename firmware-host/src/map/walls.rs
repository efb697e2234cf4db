//! The outlines of what is occupied, as GeoJSON.
//!
//! Each group of occupied cells that share edges becomes a polygon with holes. Its corners are the corners of cells; those that
//! lie less than a cell from a straight line are left out. Coordinates are metres in `map`, not the degrees of RFC 7946.

use std::collections::BTreeMap;

use runtime::mapping::CellState;
use serde_json::{Value, json};

use crate::report::known_cells::KnownCells;

/// A corner of cells: column and row.
type Corner = [i64; 2];

/// A feature collection of all outlines, in the order of their lowest cells.
pub fn geojson(cells: &KnownCells) -> Value {
    let mut labels = Labels::of(cells);
    let mut features = Vec::new();
    while let Some(group) = labels.next_group() {
        let rings: Vec<Vec<[f64; 2]>> =
            rings(&labels, &group).iter().map(|ring| in_metres(ring, cells)).collect();
        let area_m2 = group.len() as f64 * cells.resolution_m * cells.resolution_m;
        features.push(json!({
            "type": "Feature",
            "properties": { "cells": group.len(), "area_m2": (area_m2 * 1e4).round() / 1e4 },
            "geometry": { "type": "Polygon", "coordinates": rings },
        }));
    }
    json!({
        "type": "FeatureCollection",
        "properties": { "frame": "map", "unit": "m" },
        "features": features,
    })
}

/// The group of each occupied cell.
struct Labels {
    width: i64,
    height: i64,
    /// 0: not occupied, 1: not in a group yet.
    label: Vec<u32>,
    groups: u32,
    next: usize,
}

impl Labels {
    fn of(cells: &KnownCells) -> Self {
        Self {
            width: cells.width as i64,
            height: cells.height() as i64,
            label: cells.cells.iter().map(|cell| u32::from(*cell == CellState::Occupied)).collect(),
            groups: 1,
            next: 0,
        }
    }

    fn at(&self, [x, y]: Corner) -> u32 {
        let inside = (0..self.width).contains(&x) && (0..self.height).contains(&y);
        if inside { self.label[(y * self.width + x) as usize] } else { 0 }
    }

    /// Finds and labels the cells of the next group.
    fn next_group(&mut self) -> Option<Vec<Corner>> {
        let first = self.label[self.next..].iter().position(|label| *label == 1)?;
        self.next += first;
        self.groups += 1;
        let start = self.next as i64;
        let mut group = vec![[start % self.width, start / self.width]];
        self.label[self.next] = self.groups;
        let mut done = 0;
        while let Some(&[x, y]) = group.get(done) {
            done += 1;
            for neighbour in [[x + 1, y], [x, y + 1], [x - 1, y], [x, y - 1]] {
                if self.at(neighbour) == 1 {
                    self.label[(neighbour[1] * self.width + neighbour[0]) as usize] = self.groups;
                    group.push(neighbour);
                }
            }
        }
        Some(group)
    }
}

/// The closed outlines of the newest group: the outer one counter-clockwise and first, then the holes, clockwise (RFC 7946).
fn rings(labels: &Labels, group: &[Corner]) -> Vec<Vec<Corner>> {
    let mut edges = boundary(labels, group);
    let mut rings = Vec::new();
    while let Some((start, ends)) = edges.first_key_value() {
        let start = *start;
        let mut direction = difference(ends[0], start);
        let mut ring = vec![start];
        loop {
            let from = ring[ring.len() - 1];
            let Some(to) = take_edge(&mut edges, from, direction) else { break };
            direction = difference(to, from);
            ring.push(to);
        }
        rings.push(ring);
    }
    // Of all rings, the outer one has the largest extent.
    rings.sort_by_key(|ring| std::cmp::Reverse(doubled_area(ring)));
    rings
}

/// The edges between the group and other cells, with the group on their left, by their first corner.
fn boundary(labels: &Labels, group: &[Corner]) -> BTreeMap<Corner, Vec<Corner>> {
    let mut edges: BTreeMap<Corner, Vec<Corner>> = BTreeMap::new();
    for &[x, y] in group {
        let sides = [
            ([x, y - 1], [x, y], [x + 1, y]),
            ([x + 1, y], [x + 1, y], [x + 1, y + 1]),
            ([x, y + 1], [x + 1, y + 1], [x, y + 1]),
            ([x - 1, y], [x, y + 1], [x, y]),
        ];
        for (neighbour, from, to) in sides {
            if labels.at(neighbour) != labels.groups {
                edges.entry(from).or_default().push(to);
            }
        }
    }
    edges
}

/// Takes the edge that continues the outline at a corner. Where two cells of the group touch only at that corner, the outline
/// stays at the same cell, which is to the left.
fn take_edge(
    edges: &mut BTreeMap<Corner, Vec<Corner>>,
    from: Corner,
    direction: Corner,
) -> Option<Corner> {
    let ends = edges.get_mut(&from)?;
    let leftmost = (0..ends.len()).max_by_key(|at| {
        let next = difference(ends[*at], from);
        direction[0] * next[1] - direction[1] * next[0]
    })?;
    let end = ends.swap_remove(leftmost);
    if ends.is_empty() {
        edges.remove(&from);
    }
    Some(end)
}

fn difference(a: Corner, b: Corner) -> Corner {
    [a[0] - b[0], a[1] - b[1]]
}

/// Twice the area of a closed ring, positive if it is counter-clockwise.
fn doubled_area(ring: &[Corner]) -> i64 {
    ring.windows(2).map(|pair| pair[0][0] * pair[1][1] - pair[1][0] * pair[0][1]).sum()
}

/// The simplified ring in metres, closed.
fn in_metres(ring: &[Corner], cells: &KnownCells) -> Vec<[f64; 2]> {
    simplified(ring)
        .iter()
        .map(|corner| {
            [0, 1].map(|axis| {
                let metres = cells.origin_m[axis] + corner[axis] as f64 * cells.resolution_m;
                (metres * 1e4).round() / 1e4
            })
        })
        .collect()
}

/// Leaves out corners that are nearer than a cell to the line between those that stay (Douglas and Peucker 1973). The two ends
/// of the ring's longest chord stay; a ring that would become flat keeps all its corners.
fn simplified(ring: &[Corner]) -> Vec<Corner> {
    let first = ring[0];
    let farthest = (0..ring.len()).max_by_key(|at| {
        let [x, y] = difference(ring[*at], first);
        x * x + y * y
    });
    let middle = farthest.unwrap_or(0);
    let mut kept = vec![first];
    keep_corners(&ring[..=middle], &mut kept);
    keep_corners(&ring[middle..], &mut kept);
    if kept.len() < 5 { without_straight(ring) } else { kept }
}

/// Appends the corners of a line that stay, without its first.
fn keep_corners(line: &[Corner], kept: &mut Vec<Corner>) {
    let (Some(first), Some(last)) = (line.first(), line.last()) else { return };
    let chord = difference(*last, *first);
    let farthest = (1..line.len().saturating_sub(1))
        .max_by_key(|at| scaled_distance(line[*at], *first, chord));
    let length2 = chord[0] * chord[0] + chord[1] * chord[1];
    match farthest.filter(|at| scaled_distance(line[*at], *first, chord).pow(2) >= length2) {
        Some(at) => {
            keep_corners(&line[..=at], kept);
            keep_corners(&line[at..], kept);
        }
        None => kept.push(*last),
    }
}

/// The distance of a corner from the line through `first` along `chord`, times the length of `chord`.
fn scaled_distance(corner: Corner, first: Corner, chord: Corner) -> i64 {
    let [x, y] = difference(corner, first);
    (x * chord[1] - y * chord[0]).abs()
}

/// Leaves out the corners at which a ring goes straight on.
fn without_straight(ring: &[Corner]) -> Vec<Corner> {
    let mut kept: Vec<Corner> = Vec::with_capacity(ring.len());
    for corner in ring {
        if let [.., before, last] = kept[..]
            && difference(last, before).map(i64::signum)
                == difference(*corner, last).map(i64::signum)
        {
            kept.pop();
        }
        kept.push(*corner);
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Rows from top to bottom; `#` is occupied.
    fn cells(rows: &[&str]) -> KnownCells {
        KnownCells {
            width: rows[0].len(),
            cells: rows.iter().rev().flat_map(|row| row.bytes().map(state)).collect(),
            resolution_m: 0.5,
            origin_m: [10.0, -1.0],
        }
    }

    fn state(byte: u8) -> CellState {
        if byte == b'#' { CellState::Occupied } else { CellState::Free }
    }

    fn outlines(cells: &KnownCells) -> Vec<Vec<Vec<[f64; 2]>>> {
        let collection = geojson(cells);
        let features = collection["features"].as_array().unwrap().clone();
        let coordinates =
            features.into_iter().map(|mut feature| feature["geometry"]["coordinates"].take());
        coordinates.map(|rings| serde_json::from_value(rings).unwrap()).collect()
    }

    fn area_m2(ring: &[[f64; 2]]) -> f64 {
        let doubled: f64 =
            ring.windows(2).map(|pair| pair[0][0] * pair[1][1] - pair[1][0] * pair[0][1]).sum();
        doubled / 2.0
    }

    #[test]
    fn one_cell_is_a_square_in_metres() {
        let found = outlines(&cells(&["...", ".#."]));
        let square = [[10.5, -1.0], [11.0, -1.0], [11.0, -0.5], [10.5, -0.5], [10.5, -1.0]];
        assert_eq!(found, [[square.to_vec()]]);
    }

    #[test]
    fn a_room_has_an_outer_outline_and_a_hole() {
        let found = outlines(&cells(&["######", "#....#", "#....#", "#....#", "######"]));
        let [rings] = found.as_slice() else { panic!("{found:?}") };
        assert_eq!(rings.len(), 2);
        assert!((area_m2(&rings[0]) - 30.0 * 0.25).abs() < 1e-9);
        assert!((area_m2(&rings[1]) + 12.0 * 0.25).abs() < 1e-9);
        assert!(rings.iter().all(|ring| ring.len() == 5), "{rings:?}");
    }

    #[test]
    fn cells_that_touch_at_a_corner_are_two_groups() {
        assert_eq!(outlines(&cells(&["#.", ".#"])).len(), 2);
    }

    #[test]
    fn a_wall_that_is_not_parallel_to_the_cells_gets_straight_sides() {
        let rows: Vec<String> = (0..40)
            .rev()
            .map(|y| {
                (0..120).map(|x| if (x / 3_i32).abs_diff(y) < 2 { '#' } else { '.' }).collect()
            })
            .collect();
        let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
        let found = outlines(&cells(&rows));
        let [rings] = found.as_slice() else { panic!("{} groups", found.len()) };
        assert!(rings[0].len() <= 12, "{} corners", rings[0].len());
    }

    proptest! {
        #[test]
        fn outlines_before_simplification_enclose_exactly_the_occupied_cells(
            occupied in prop::collection::vec(any::<bool>(), 12 * 9),
        ) {
            let states = occupied.iter().map(|occupied| {
                if *occupied { CellState::Occupied } else { CellState::Unknown }
            });
            let cells = KnownCells {
                width: 12, cells: states.collect(), resolution_m: 1.0, origin_m: [0.0; 2],
            };
            let mut labels = Labels::of(&cells);
            let mut total = 0;
            while let Some(group) = labels.next_group() {
                let rings = rings(&labels, &group);
                prop_assert!(rings.iter().all(|ring| ring.first() == ring.last()));
                prop_assert!(rings[1..].iter().all(|ring| doubled_area(ring) < 0), "holes");
                let area: i64 = rings.iter().map(|ring| doubled_area(ring)).sum();
                prop_assert_eq!(area, 2 * group.len() as i64);
                total += group.len();
            }
            prop_assert_eq!(total, occupied.iter().filter(|occupied| **occupied).count());
        }
    }
}
