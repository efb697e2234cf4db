//! Which of the loops that localization closed contradict the ground truth.
//!
//! The true pose of one end of a loop in the other follows from relations: from one relation, if both ends are near its times,
//! or else from the shortest chain of relations between them. From an end to the nearest time of a relation, 0.3 s at most, the
//! final trajectory counts: over a whole second its own errors make right closures seem wrong.

use std::collections::VecDeque;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use hal::{Pose2, wrap_angle};

use super::relations::{Clock, Relation};
use super::trajectory::Trajectory;

/// A closure that is further from the truth than this is wrong, metres and degrees.
const WRONG_M: f64 = 0.25;
const WRONG_DEG: f64 = 5.0;
/// An end of a loop belongs to a relation's time that is this near.
const NEAR_S: f64 = 0.3;

/// A line of `closures.csv`.
struct Closure {
    times_s: [f64; 2],
    t_from_to: Pose2,
    /// How far the final poses are from it, metres and degrees.
    off: [f64; 2],
    is_held: bool,
    /// The line itself.
    line: String,
}

impl Closure {
    fn parse(line: &str) -> Result<Self> {
        let cells: Vec<&str> = line.split(',').collect();
        ensure!(cells.len() == 12, "`{line}` has {} cells instead of 12", cells.len());
        let number = |index: usize| -> Result<f64> {
            cells[index].parse().with_context(|| format!("`{line}` is not a closure"))
        };
        Ok(Self {
            times_s: [number(2)?, number(3)?],
            t_from_to: Pose2::new(number(5)?, number(6)?, number(7)?.to_radians()),
            off: [number(8)?, number(9)?],
            is_held: cells[11] == "1",
            line: line.to_owned(),
        })
    }
}

/// A closure beside its truth.
struct Checked {
    /// The error of the closure, metres and degrees.
    off: [f64; 2],
    relations: usize,
}

impl Checked {
    fn is_wrong(&self) -> bool {
        is_wrong(&self.off)
    }
}

fn is_wrong([metres, degrees]: &[f64; 2]) -> bool {
    *metres > WRONG_M || *degrees > WRONG_DEG
}

/// What became of a log's closures.
pub struct Report {
    closures: Vec<(Closure, Option<Checked>)>,
    /// Closures that were accepted.
    accepted: u64,
}

impl Report {
    /// Reads `closures.csv` of `out` and compares it with the relations.
    pub fn new(
        out: &Path,
        accepted: u64,
        relations: &[Relation],
        clock: &Clock,
        trajectory: &Trajectory,
    ) -> Result<Self> {
        let path = out.join("closures.csv");
        let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let chains = Chains::new(relations, clock);
        let mut closures = Vec::new();
        for line in text.lines().skip(1) {
            let closure = Closure::parse(line)?;
            let checked = chains.check(&closure, clock, trajectory);
            closures.push((closure, checked));
        }
        Ok(Self { closures, accepted })
    }

    /// One sentence for each figure.
    pub fn sentences(&self, log: &str) -> String {
        let held = self.closures.iter().filter(|(closure, _)| closure.is_held);
        let checked: Vec<&Checked> =
            held.clone().filter_map(|(_, checked)| checked.as_ref()).collect();
        let wrong = checked.iter().filter(|checked| checked.is_wrong()).count();
        let is_wrong_twice = |(closure, checked): &&(Closure, Option<Checked>)| {
            is_wrong(&closure.off) && checked.as_ref().is_some_and(Checked::is_wrong)
        };
        let twice = held.clone().filter(is_wrong_twice).count();
        let direct = checked.iter().filter(|checked| checked.relations == 1).count();
        let longest = checked.iter().map(|checked| checked.relations).max().unwrap_or(0);
        let held = held.count();
        let [m, deg] = [0, 1].map(|axis| {
            let mut off: Vec<f64> = checked.iter().map(|checked| checked.off[axis]).collect();
            off.sort_by(f64::total_cmp);
            [0.5, 0.99, 1.0].map(|share| quantile(&off, share))
        });
        let mut text = format!(
            "{log}: {} closures were accepted, and {held} of them hold at the end. {} of these were checked: {direct} by one \
             relation, the others by chains of up to {longest}. {wrong} are off by more than {WRONG_M} m or {WRONG_DEG} degrees, and {twice} of \
             these are as far from the final poses as well. Off by (p50 / p99 / max): {:.3} / {:.3} / {:.3} m, {:.2} / {:.2} / {:.2} degrees.\n",
            self.accepted,
            checked.len(),
            m[0],
            m[1],
            m[2],
            deg[0],
            deg[1],
            deg[2],
        );
        for (closure, checked) in &self.closures {
            if let Some(checked) = checked.as_ref().filter(|checked| checked.is_wrong()) {
                let what = if closure.is_held { "wrong" } else { "wrong, and dropped" };
                let [metres, degrees] = checked.off;
                // Writing into a String cannot fail.
                let _ = writeln!(
                    text,
                    "{log}: {what} by {metres:.3} m, {degrees:.2} degrees ({} relations): {}",
                    checked.relations, closure.line
                );
            }
        }
        text
    }

    /// The lines of `closures.csv` with the error of each closure and the number of relations that it follows from.
    pub fn csv(&self) -> String {
        let mut text = "from,to,from_s,to_s,closed_s,x_m,y_m,yaw_deg,off_m,off_deg,weight,is_held,\
                        error_m,error_deg,relations\n"
            .to_owned();
        for (closure, checked) in &self.closures {
            let truth = checked.as_ref().map_or_else(
                || ",,".to_owned(),
                |Checked { off: [metres, degrees], relations }| {
                    format!("{metres:.4},{degrees:.3},{relations}")
                },
            );
            let _ = writeln!(text, "{},{truth}", closure.line);
        }
        text
    }
}

fn quantile(sorted: &[f64], share: f64) -> f64 {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}

/// Relations as ways between their times.
struct Chains {
    /// Sorted, in the log's time.
    times_s: Vec<f64>,
    /// From each time, the times that a relation leads to, and the true pose there.
    ways: Vec<Vec<(usize, Pose2)>>,
}

impl Chains {
    fn new(relations: &[Relation], clock: &Clock) -> Self {
        let ends = relations.iter().map(|relation| relation.log_times_s(clock));
        let ends: Vec<[f64; 2]> = ends.collect();
        let mut times_s: Vec<f64> = ends.iter().flatten().copied().collect();
        times_s.sort_by(f64::total_cmp);
        times_s.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
        let mut ways = vec![Vec::new(); times_s.len()];
        for (times, relation) in ends.iter().zip(relations) {
            let [first, second] =
                times.map(|time| times_s.partition_point(|other| *other < time - 1e-6));
            ways[first].push((second, relation.motion()));
            ways[second].push((first, relation.motion().inverse()));
        }
        Self { times_s, ways }
    }

    /// The times of relations that are near, the nearest first.
    fn near(&self, time_s: f64) -> Vec<usize> {
        let from = self.times_s.partition_point(|other| *other < time_s - NEAR_S);
        let to = self.times_s.partition_point(|other| *other <= time_s + NEAR_S);
        let mut near: Vec<usize> = (from..to).collect();
        let apart = |index: &usize| (self.times_s[*index] - time_s).abs();
        near.sort_by(|a, b| apart(a).total_cmp(&apart(b)));
        near
    }

    /// The shortest chain of relations from one of the starts to one of the ends: the start, the end, the true pose of the end in
    /// the start, and the number of relations.
    fn between(&self, starts: &[usize], ends: &[usize]) -> Option<(usize, usize, Pose2, usize)> {
        let mut reached: Vec<Option<(usize, Pose2, usize)>> = vec![None; self.times_s.len()];
        let mut queue = VecDeque::new();
        for start in starts {
            reached[*start] = Some((*start, Pose2::IDENTITY, 0));
            queue.push_back(*start);
        }
        while let Some(here) = queue.pop_front() {
            let (start, pose, relations) = reached[here]?;
            if relations > 0 && ends.contains(&here) {
                return Some((start, here, pose, relations));
            }
            for (there, motion) in &self.ways[here] {
                if reached[*there].is_none() {
                    reached[*there] = Some((start, pose.compose(motion), relations + 1));
                    queue.push_back(*there);
                }
            }
        }
        None
    }

    fn check(&self, closure: &Closure, clock: &Clock, poses: &Trajectory) -> Option<Checked> {
        let [from_s, to_s] = closure.times_s;
        let (start, end, motion, relations) = self.between(&self.near(from_s), &self.near(to_s))?;
        let [first, last] = [start, end].map(|index| clock.pose_in_log(self.times_s[index], poses));
        let [from, to] = closure.times_s.map(|time_s| clock.pose_in_log(time_s, poses));
        let (from, to) = (from?, to?);
        // In the frame that the truth is about.
        let truth =
            from.inverse().compose(&first?).compose(&motion).compose(&last?.inverse()).compose(&to);
        let matched = clock.in_truths_frame(&closure.t_from_to);
        let error = truth.inverse().compose(&matched);
        let degrees = wrap_angle(error.yaw_rad).abs().to_degrees();
        Some(Checked { off: [error.x_m.hypot(error.y_m), degrees], relations })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot that drives 1 m each second for three seconds, and then stands.
    fn trajectory() -> Trajectory {
        let xs = [0.0, 1.0, 2.0, 3.0, 3.0, 3.0];
        let poses: Vec<_> =
            (1..).zip(xs).map(|(time, x_m)| (f64::from(time), Pose2::new(x_m, 0.0, 0.0))).collect();
        Trajectory::of(&poses)
    }

    fn report(relations: &[&str], closure: &str) -> Report {
        let relations: Vec<_> =
            relations.iter().map(|line| Relation::parse(line).unwrap()).collect();
        let closure = Closure::parse(closure).unwrap();
        let chains = Chains::new(&relations, &Clock::PLAIN);
        let checked = chains.check(&closure, &Clock::PLAIN, &trajectory());
        Report { closures: vec![(closure, checked)], accepted: 1 }
    }

    #[test]
    fn a_closure_is_compared_with_the_relation_between_its_ends() {
        let right = "0,9,1.1,4.9,5,2.9,0.0,0.0,0,0,1,1";
        let report = report(&["1 5 3 0 0 0 0 0"], right);
        let checked = report.closures[0].1.as_ref().unwrap();
        assert_eq!(checked.relations, 1);
        assert!(!checked.is_wrong(), "{:?}", checked.off);
        assert!(report.sentences("log").contains("1 of these were checked: 1 by one relation"));
    }

    #[test]
    fn without_a_relation_between_its_ends_the_truth_follows_from_a_chain() {
        let wrong = "0,9,1.0,5.0,5,3.3,0.0,0.0,0,0,1,1";
        let chain = ["1 3 2 0 0 0 0 0", "5 3 -1 0 0 0 0 0"];
        let report = report(&chain, wrong);
        let checked = report.closures[0].1.as_ref().unwrap();
        assert_eq!(checked.relations, 2);
        assert!((checked.off[0] - 0.3).abs() < 1e-9 && checked.is_wrong());
        assert!(report.sentences("log").contains("log: wrong by 0.300 m"));
        assert!(report.csv().ends_with(",1,0.3000,0.000,2\n"));
    }

    #[test]
    fn a_closure_without_relations_near_its_ends_is_not_checked() {
        let report = report(&["1 2 1 0 0 0 0 0"], "0,9,1.0,5.0,5,3.3,0.0,0.0,0,0,1,1");
        assert!(report.closures[0].1.is_none());
        assert!(report.csv().ends_with(",1,,,\n"));
    }
}
