//! A tour of all reachable floor of a simulated home.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use hal::{Pose2, wrap_angle};
use simulator::floor::FloorPlan;

/// Distance between nodes of the tour, metres.
const NODE_M: f64 = 0.25;
/// Distance to furniture, metres.
const CLEARANCE_M: f64 = 0.22;
/// Floor this near to the tour has been visited, metres.
const VISITED_M: f64 = 1.2;
/// Motion between two scans.
const STEP_M: f64 = 0.06;
const STEP_RAD: f64 = 0.1;

type Node = (i32, i32);

/// Poses from `start` to everywhere, one for each scan.
pub fn through(plan: &FloorPlan, start: Pose2) -> Vec<Pose2> {
    let nodes = nodes(plan);
    let mut poses = vec![start];
    let Some(mut here) = nearest(&nodes, &start) else { return poses };
    let mut open = nodes.clone();
    loop {
        open.retain(|node| distance_m(*node, place(here)) > VISITED_M);
        let Some(path) = path_to_nearest(&nodes, here, &open) else { return poses };
        for node in path {
            drive(&mut poses, place(node));
            open.retain(|other| distance_m(*other, place(node)) > VISITED_M);
            here = node;
        }
    }
}

fn nodes(plan: &FloorPlan) -> BTreeSet<Node> {
    let nodes = plan.reachable().map(|place_m| {
        let [x, y] = place_m.map(|value| (value / NODE_M).round() as i32);
        (x, y)
    });
    nodes.filter(|node| is_clear(*node, plan)).collect()
}

fn is_clear(node: Node, plan: &FloorPlan) -> bool {
    let [x_m, y_m] = place(node);
    plan.is_reachable(x_m, y_m) && plan.clearance_m(x_m, y_m) > CLEARANCE_M
}

fn place((x, y): Node) -> [f64; 2] {
    [f64::from(x) * NODE_M, f64::from(y) * NODE_M]
}

fn distance_m(node: Node, to: [f64; 2]) -> f64 {
    let [x_m, y_m] = place(node);
    (x_m - to[0]).hypot(y_m - to[1])
}

fn nearest(nodes: &BTreeSet<Node>, pose: &Pose2) -> Option<Node> {
    let here = [pose.x_m, pose.y_m];
    nodes.iter().copied().min_by(|a, b| distance_m(*a, here).total_cmp(&distance_m(*b, here)))
}

/// The shortest path to the nearest open node, without its beginning.
fn path_to_nearest(nodes: &BTreeSet<Node>, here: Node, open: &BTreeSet<Node>) -> Option<Vec<Node>> {
    let mut before = BTreeMap::from([(here, here)]);
    let mut queue = VecDeque::from([here]);
    while let Some(node) = queue.pop_front() {
        if open.contains(&node) {
            let mut path = vec![node];
            while let Some(earlier) = path.last().and_then(|last| before.get(last))
                && *earlier != here
            {
                path.push(*earlier);
            }
            path.reverse();
            return Some(path);
        }
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let next = (node.0 + dx, node.1 + dy);
            if nodes.contains(&next) && !before.contains_key(&next) {
                before.insert(next, node);
                queue.push_back(next);
            }
        }
    }
    None
}

/// Rotates towards a place and drives there.
fn drive(poses: &mut Vec<Pose2>, [x_m, y_m]: [f64; 2]) {
    while let Some(last) = poses.last().copied() {
        let dx = x_m - last.x_m;
        let dy = y_m - last.y_m;
        let distance_m = dx.hypot(dy);
        if distance_m < 1e-6 {
            return;
        }
        let off_rad = wrap_angle(dy.atan2(dx) - last.yaw_rad);
        let motion = if off_rad.abs() > 1e-6 {
            Pose2::new(0.0, 0.0, off_rad.clamp(-STEP_RAD, STEP_RAD))
        } else {
            Pose2::new(distance_m.min(STEP_M), 0.0, 0.0)
        };
        poses.push(last.compose(&motion));
    }
}
