//! How uncertain the pose of one submap is in the frame of another: along the best known path between them.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::pose_graph::{Edge, PoseGraph};

/// Metres that a radian counts as when paths are compared.
const METRES_PER_RADIAN: f64 = 5.0;

/// A submap that has been reached.
struct Reached {
    /// Size of its uncertainty.
    cost: f64,
    node: u32,
    covariance: Matrix3<f64>,
}

impl Ord for Reached {
    /// The smallest cost is the greatest, and is popped first.
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost.total_cmp(&self.cost).then(other.node.cmp(&self.node))
    }
}

impl PartialOrd for Reached {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Reached {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Reached {}

/// Finds paths of least uncertainty (Dijkstra). It keeps its memory; every search overwrites it.
#[derive(Default)]
pub(crate) struct Drift {
    covariances: Vec<Option<Matrix3<f64>>>,
    neighbours: Vec<Vec<u32>>,
    open: BinaryHeap<Reached>,
}

impl Drift {
    /// Covariance of every submap's pose (x and y in the axes of `map`, yaw) with the submap `from` held fixed.
    pub(crate) fn from(&mut self, graph: &PoseGraph, from: u32) -> &[Option<Matrix3<f64>>] {
        let poses = graph.poses();
        self.link(graph);
        self.covariances.clear();
        self.covariances.resize(poses.len(), None);
        self.open.clear();
        self.open.push(Reached { cost: 0.0, node: from, covariance: Matrix3::zeros() });
        while let Some(Reached { node, covariance, .. }) = self.open.pop() {
            let here = node as usize;
            if self.covariances[here].is_some() {
                continue;
            }
            self.covariances[here] = Some(covariance);
            for index in &self.neighbours[here] {
                let edge = edge(graph, *index);
                let next = if edge.from == node { edge.to } else { edge.from };
                if self.covariances[next as usize].is_some() {
                    continue;
                }
                let Some(noise) = edge.information.try_inverse() else { continue };
                let yaw_rad = poses[edge.from as usize].yaw_rad;
                let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw_rad);
                let noise = rotation.matrix() * noise * rotation.matrix().transpose();
                let mut spread = Matrix3::identity();
                spread[(0, 2)] = poses[here].y_m - poses[next as usize].y_m;
                spread[(1, 2)] = poses[next as usize].x_m - poses[here].x_m;
                let covariance = spread * covariance * spread.transpose() + noise;
                self.open.push(Reached { cost: cost(&covariance), node: next, covariance });
            }
        }
        &self.covariances
    }

    fn link(&mut self, graph: &PoseGraph) {
        self.neighbours.resize(graph.poses().len(), Vec::new());
        for neighbours in &mut self.neighbours {
            neighbours.clear();
        }
        let count = graph.drives().len() + graph.closures().len();
        for index in 0..count as u32 {
            let edge = edge(graph, index);
            self.neighbours[edge.from as usize].push(index);
            self.neighbours[edge.to as usize].push(index);
        }
    }
}

/// Drives first, then closures.
fn edge(graph: &PoseGraph, index: u32) -> &Edge {
    let index = index as usize;
    let drives = graph.drives();
    if index < drives.len() { &drives[index] } else { &graph.closures()[index - drives.len()] }
}

fn cost(covariance: &Matrix3<f64>) -> f64 {
    let yaw = METRES_PER_RADIAN * METRES_PER_RADIAN * covariance[(2, 2)];
    covariance[(0, 0)] + covariance[(1, 1)] + yaw
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::Pose2;

    fn straight(count: usize) -> PoseGraph {
        let mut graph = PoseGraph::default();
        graph.begin(Pose2::IDENTITY);
        for _ in 1..count {
            let information = Matrix3::from_diagonal(&Vector3::new(1e4, 1e4, 1e4));
            graph.drive(Pose2::new(1.0, 0.0, 0.0), information);
        }
        graph
    }

    #[test]
    fn drift_across_a_straight_drive_grows_with_the_cube_of_its_length() {
        let graph = straight(101);
        let mut drift = Drift::default();
        let covariances = drift.from(&graph, 0);
        let end = covariances[100].unwrap();
        // Random yaw of variance q per metre: q n³ / 3 across after n metres.
        assert!((end[(1, 1)] / (1e-4 * 1e6 / 3.0) - 1.0).abs() < 0.05, "{end}");
        assert!((end[(2, 2)] - 1e-2).abs() < 1e-9);
    }

    #[test]
    fn a_closure_is_a_shorter_way() {
        let mut graph = straight(101);
        let far = Drift::default().from(&graph, 0)[99].unwrap();
        let information = Matrix3::from_diagonal(&Vector3::new(1e4, 1e4, 1e4));
        let t_from_to = Pose2::new(100.0, 0.0, 0.0);
        graph.close(Edge { from: 0, to: 100, t_from_to, information, weight: 1.0 });
        let near = Drift::default().from(&graph, 0)[99].unwrap();
        assert!(near[(1, 1)] < 0.1 * far[(1, 1)]);
    }
}
