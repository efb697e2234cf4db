//! The poses of all submaps, from the drives between them and the loops that were closed.
//!
//! Least squares over poses in the plane by Gauss-Newton. Each step is solved by conjugate gradients whose preconditioner is the
//! exact solution for the chain of drives: the chain alone needs one iteration, and every closure adds about one more. A step
//! that is cut off early is still a step downhill, so that work can be spread over updates.

use hal::{Pose2, wrap_angle};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::snapshot::remembers;

/// Iterations of conjugate gradients in one step: as many as the work of one update allows, within these bounds.
const MIN_ITERATIONS: u64 = 3;
const MAX_ITERATIONS: u64 = 20;
/// Operations of one iteration for one block of the system, about.
const BLOCK_OPERATIONS: u64 = 10;
/// Keeps the first pose where it is, against information of up to 1e6 of any edge.
const ANCHOR: f64 = 1e10;
/// Dynamic covariance scaling (Agarwal et al. 2013): closures whose squared Mahalanobis distance is larger count less. For
/// three degrees of freedom, 3 % of right ones exceed it.
const KERNEL: f64 = 9.0;
/// A closure whose squared Mahalanobis distance is larger contradicts the others and is dropped.
const DROPPED: f64 = 70.0;

/// What is known of the pose of one submap in the frame of another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Edge {
    pub from: u32,
    pub to: u32,
    pub t_from_to: Pose2,
    /// Inverse covariance of x, y (in the axes of `from`) and yaw.
    pub information: Matrix3<f64>,
    /// 1, or less for a closure that does not agree with the others.
    pub weight: f64,
}

/// Poses and edges.
#[derive(Default)]
pub(crate) struct PoseGraph {
    poses: Vec<Pose2>,
    /// Edge `i` is the drive from submap `i` to submap `i + 1`.
    drives: Vec<Edge>,
    closures: Vec<Edge>,
    system: System,
}

remembers!(PoseGraph: poses, drives, closures);

/// The linearized problem, and the vectors of its solution. Every step overwrites it.
#[derive(Default)]
struct System {
    diagonal: Vec<Matrix3<f64>>,
    /// Block (i, i + 1) of each drive, and block (from, to) of each closure.
    drive_blocks: Vec<Matrix3<f64>>,
    closure_blocks: Vec<Matrix3<f64>>,
    /// Inverse pivots of the chain's factorization.
    pivots: Vec<Matrix3<f64>>,
    gradient: Vec<Vector3<f64>>,
    step: Vec<Vector3<f64>>,
    residual: Vec<Vector3<f64>>,
    direction: Vec<Vector3<f64>>,
    preconditioned: Vec<Vector3<f64>>,
    product: Vec<Vector3<f64>>,
}

impl PoseGraph {
    pub(crate) fn poses(&self) -> &[Pose2] {
        &self.poses
    }

    pub(crate) fn drives(&self) -> &[Edge] {
        &self.drives
    }

    pub(crate) fn closures(&self) -> &[Edge] {
        &self.closures
    }

    /// The first submap, which stays where it is.
    pub(crate) fn begin(&mut self, pose: Pose2) {
        self.poses.push(pose);
    }

    /// A new submap, and the drive to it from the last one.
    pub(crate) fn drive(&mut self, t_last_new: Pose2, information: Matrix3<f64>) {
        let Some(last) = self.poses.last() else { return };
        let pose = last.compose(&t_last_new);
        let to = self.poses.len() as u32;
        let from = to - 1;
        self.drives.push(Edge { from, to, t_from_to: t_last_new, information, weight: 1.0 });
        self.poses.push(pose);
    }

    /// Replaces the pose of a submap, from which the next step begins.
    pub(crate) fn set_pose(&mut self, index: usize, pose: Pose2) {
        self.poses[index] = pose;
    }

    pub(crate) fn close(&mut self, closure: Edge) {
        self.closures.push(closure);
    }

    /// One step of the optimization, in about this number of operations. Returns the largest change of a coordinate, in metres or radians.
    pub(crate) fn step(&mut self, operations: u64) -> f64 {
        let iterations = operations / self.iteration_operations().max(1);
        self.linearize();
        self.system.factor();
        self.system.solve(&self.closures, iterations.clamp(MIN_ITERATIONS, MAX_ITERATIONS));
        let mut largest = 0.0_f64;
        for (pose, step) in self.poses.iter_mut().zip(&self.system.step) {
            largest = largest.max(step.amax());
            *pose = Pose2::new(pose.x_m + step.x, pose.y_m + step.y, pose.yaw_rad + step.z);
        }
        largest
    }

    /// Operations of one iteration within a [`step`](Self::step), about.
    fn iteration_operations(&self) -> u64 {
        let blocks = 3 * self.poses.len() + self.drives.len() + 2 * self.closures.len();
        blocks as u64 * BLOCK_OPERATIONS
    }

    /// Drops the closure that contradicts the poses most, if there is one; else weighs every closure by how well it agrees.
    /// Returns whether the poses must be improved again. One at a time, because a wrong closure bends the poses so that right
    /// ones seem wrong too.
    pub(crate) fn weigh(&mut self) -> bool {
        let mut worst = DROPPED;
        let mut drop = None;
        let mut changed = false;
        for (index, closure) in self.closures.iter().enumerate() {
            let distance = distance(closure, &self.poses);
            if distance > worst {
                worst = distance;
                drop = Some(index);
            }
        }
        if let Some(index) = drop {
            self.closures.remove(index);
            return true;
        }
        for closure in &mut self.closures {
            let scale = (2.0 * KERNEL / (KERNEL + distance(closure, &self.poses))).min(1.0);
            changed |= (scale * scale - closure.weight).abs() > 0.05;
            closure.weight = scale * scale;
        }
        changed
    }

    fn linearize(&mut self) {
        let count = self.poses.len();
        let system = &mut self.system;
        system.resize(count);
        system.drive_blocks.clear();
        system.closure_blocks.clear();
        for edge in &self.drives {
            let block = system.add(edge, &self.poses);
            system.drive_blocks.push(block);
        }
        for edge in &self.closures {
            let block = system.add(edge, &self.poses);
            system.closure_blocks.push(block);
        }
        if let Some(first) = system.diagonal.first_mut() {
            *first += Matrix3::from_diagonal_element(ANCHOR);
        }
    }
}

/// By how much the poses differ from the edge, in the axes of `from`.
fn error(edge: &Edge, poses: &[Pose2]) -> Vector3<f64> {
    let [from, to] = [edge.from, edge.to].map(|index| poses[index as usize]);
    let there = from.inverse().compose(&to);
    let expected = edge.t_from_to;
    Vector3::new(
        there.x_m - expected.x_m,
        there.y_m - expected.y_m,
        wrap_angle(there.yaw_rad - expected.yaw_rad),
    )
}

/// The squared Mahalanobis distance of the poses from the edge.
fn distance(edge: &Edge, poses: &[Pose2]) -> f64 {
    let error = error(edge, poses);
    error.dot(&(edge.information * error))
}

impl System {
    fn resize(&mut self, count: usize) {
        self.diagonal.clear();
        self.diagonal.resize(count, Matrix3::zeros());
        self.pivots.resize(count, Matrix3::zeros());
        self.gradient.clear();
        self.gradient.resize(count, Vector3::zeros());
        for vector in [
            &mut self.step,
            &mut self.residual,
            &mut self.direction,
            &mut self.preconditioned,
            &mut self.product,
        ] {
            vector.resize(count, Vector3::zeros());
        }
    }

    /// Adds an edge to diagonal and gradient. Returns its block (from, to).
    fn add(&mut self, edge: &Edge, poses: &[Pose2]) -> Matrix3<f64> {
        let (from, to) = (edge.from as usize, edge.to as usize);
        let (sin, cos) = poses[from].yaw_rad.sin_cos();
        let dx = poses[to].x_m - poses[from].x_m;
        let dy = poses[to].y_m - poses[from].y_m;
        let to_jacobian = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
        let mut from_jacobian = -to_jacobian;
        from_jacobian[(0, 2)] = cos * dy - sin * dx;
        from_jacobian[(1, 2)] = -cos * dx - sin * dy;
        let information = edge.information * edge.weight;
        let error = error(edge, poses);
        let weighted_from = from_jacobian.transpose() * information;
        let weighted_to = to_jacobian.transpose() * information;
        self.diagonal[from] += weighted_from * from_jacobian;
        self.diagonal[to] += weighted_to * to_jacobian;
        self.gradient[from] += weighted_from * error;
        self.gradient[to] += weighted_to * error;
        weighted_from * to_jacobian
    }

    /// Factors the chain: the diagonal and the blocks of the drives.
    fn factor(&mut self) {
        let mut pivot = Matrix3::zeros();
        for (index, diagonal) in self.diagonal.iter().enumerate() {
            let mut rest = *diagonal;
            if index > 0 {
                let block = &self.drive_blocks[index - 1];
                rest -= block.transpose() * pivot * block;
            }
            pivot = rest.try_inverse().unwrap_or_else(Matrix3::zeros);
            self.pivots[index] = pivot;
        }
    }

    /// `preconditioned` = (chain)^-1 `residual`.
    fn precondition(&mut self) {
        let count = self.pivots.len();
        for index in 0..count {
            let mut value = self.residual[index];
            if index > 0 {
                let block = &self.drive_blocks[index - 1];
                value -= block.tr_mul(&self.preconditioned[index - 1]);
            }
            // Kept divided by the pivot.
            self.preconditioned[index] = self.pivots[index] * value;
        }
        for index in (0..count.saturating_sub(1)).rev() {
            let next = self.drive_blocks[index] * self.preconditioned[index + 1];
            self.preconditioned[index] -= self.pivots[index] * next;
        }
    }

    /// `product` = H `direction`.
    fn multiply(&mut self, closures: &[Edge]) {
        for (index, diagonal) in self.diagonal.iter().enumerate() {
            self.product[index] = diagonal * self.direction[index];
        }
        for (index, block) in self.drive_blocks.iter().enumerate() {
            self.product[index] += block * self.direction[index + 1];
            self.product[index + 1] += block.tr_mul(&self.direction[index]);
        }
        for (closure, block) in closures.iter().zip(&self.closure_blocks) {
            let (from, to) = (closure.from as usize, closure.to as usize);
            self.product[from] += block * self.direction[to];
            self.product[to] += block.tr_mul(&self.direction[from]);
        }
    }

    /// Conjugate gradients: `step` = -H^-1 `gradient`, approximately.
    fn solve(&mut self, closures: &[Edge], iterations: u64) {
        self.step.fill(Vector3::zeros());
        for (residual, gradient) in self.residual.iter_mut().zip(&self.gradient) {
            *residual = -gradient;
        }
        self.precondition();
        self.direction.copy_from_slice(&self.preconditioned);
        let mut energy = dot(&self.residual, &self.preconditioned);
        let enough = 1e-12 * energy;
        for _ in 0..iterations {
            if energy <= enough || energy <= 1e-18 {
                return;
            }
            self.multiply(closures);
            let length = energy / dot(&self.direction, &self.product);
            add_scaled(&mut self.step, length, &self.direction);
            add_scaled(&mut self.residual, -length, &self.product);
            self.precondition();
            let next = dot(&self.residual, &self.preconditioned);
            let share = next / energy;
            for (direction, new) in self.direction.iter_mut().zip(&self.preconditioned) {
                *direction = new + *direction * share;
            }
            energy = next;
        }
    }
}

fn dot(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}

fn add_scaled(to: &mut [Vector3<f64>], scale: f64, what: &[Vector3<f64>]) {
    for (to, what) in to.iter_mut().zip(what) {
        *to += what * scale;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn information() -> Matrix3<f64> {
        Matrix3::from_diagonal(&Vector3::new(1e4, 1e4, 1e5))
    }

    /// A ring of 40 submaps, driven with a wrong yaw on every drive.
    fn ring(bias_rad: f64) -> (PoseGraph, Vec<Pose2>) {
        let drive = Pose2::new(1.0, 0.0, std::f64::consts::TAU / 40.0);
        let biased = Pose2::new(1.0, 0.0, drive.yaw_rad + bias_rad);
        let mut graph = PoseGraph::default();
        let mut truth = vec![Pose2::IDENTITY];
        graph.begin(Pose2::IDENTITY);
        for index in 0..39 {
            graph.drive(biased, information());
            truth.push(truth[index].compose(&drive));
        }
        (graph, truth)
    }

    fn closure(truth: &[Pose2], from: u32, to: u32) -> Edge {
        let t_from_to = truth[from as usize].inverse().compose(&truth[to as usize]);
        Edge { from, to, t_from_to, information: information(), weight: 1.0 }
    }

    fn settle(graph: &mut PoseGraph) {
        for _ in 0..30 {
            if graph.step(u64::MAX) < 1e-9 {
                return;
            }
        }
        panic!("not settled");
    }

    fn cost(graph: &PoseGraph) -> f64 {
        let edges = graph.drives.iter().chain(&graph.closures);
        let costs = edges.map(|edge| edge.weight * distance(edge, &graph.poses));
        costs.sum()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn drives_without_closures_stay_as_they_are(bias in -0.05..0.05f64) {
            let (mut graph, _) = ring(bias);
            let before = graph.poses.clone();
            prop_assert!(graph.step(u64::MAX) < 1e-9);
            prop_assert_eq!(graph.poses.len(), before.len());
        }

        #[test]
        fn the_solution_is_a_minimum(
            bias in -0.01..0.01f64,
            node in 1usize..40,
            axis in 0usize..3,
            sign in prop::sample::select(vec![-1.0, 1.0]),
        ) {
            let (mut graph, truth) = ring(bias);
            graph.close(closure(&truth, 0, 39));
            graph.close(closure(&truth, 5, 30));
            settle(&mut graph);
            let least = cost(&graph);
            let pose = &mut graph.poses[node];
            match axis {
                0 => pose.x_m += sign * 1e-4,
                1 => pose.y_m += sign * 1e-4,
                _ => pose.yaw_rad += sign * 1e-4,
            }
            prop_assert!(cost(&graph) > least);
        }
    }

    #[test]
    fn with_little_work_a_step_the_solution_is_the_same() {
        let [mut patient, mut hasty] = [ring(0.004).0, ring(0.004).0];
        let truth = ring(0.004).1;
        for graph in [&mut patient, &mut hasty] {
            for (from, to) in [(0, 39), (2, 37), (4, 35), (6, 33), (8, 31), (10, 29)] {
                graph.close(closure(&truth, from, to));
            }
        }
        settle(&mut patient);
        for _ in 0..400 {
            hasty.step(1);
        }
        for (a, b) in patient.poses.iter().zip(&hasty.poses) {
            assert!(a.distance_m(b) < 1e-4, "{a:?} {b:?}");
        }
    }

    #[test]
    fn a_closed_ring_is_a_ring_again() {
        let (mut graph, truth) = ring(0.004);
        let before = graph.poses[39].distance_m(&truth[39]);
        graph.close(closure(&truth, 0, 39));
        settle(&mut graph);
        let after = graph.poses.iter().zip(&truth).map(|(pose, truth)| pose.distance_m(truth));
        let worst = after.fold(0.0, f64::max);
        assert!(before > 0.4 && worst < 0.15 * before, "{before} m -> {worst} m");
    }

    #[test]
    fn a_wrong_closure_among_right_ones_is_dropped() {
        let (mut graph, truth) = ring(0.002);
        for (from, to) in [(0, 39), (1, 38), (5, 30), (10, 35)] {
            graph.close(closure(&truth, from, to));
        }
        let mut wrong = closure(&truth, 3, 20);
        wrong.t_from_to.x_m += 4.0;
        graph.close(wrong);
        for _ in 0..10 {
            settle(&mut graph);
            if !graph.weigh() {
                break;
            }
        }
        assert!(graph.closures.iter().all(|closure| closure.to != 20), "{:?}", graph.closures);
        assert_eq!(graph.closures.len(), 4);
    }
}
