//! The loops that localization closed along a log, as a list.

use std::fmt::Write as _;

use hal::{Pose2, wrap_angle};
use runtime::localization::{Closure, Localizer};

/// The columns of `closures.csv`.
const COLUMNS: &str = "from,to,from_s,to_s,closed_s,x_m,y_m,yaw_deg,off_m,off_deg,weight,is_held\n";

/// Two submaps that were recognized as overlapping.
#[derive(Debug, Clone, PartialEq)]
pub struct ListedClosure {
    closure: Closure,
    /// Times at which both submaps began: their frames are the robot's poses at these times.
    times_s: [f64; 2],
    /// When it was accepted.
    closed_s: f64,
    /// The pose of the second submap in the first, by their final poses in `map`.
    finally: Pose2,
    /// Whether it holds at the end. A closure that contradicts the others is dropped.
    is_held: bool,
}

impl ListedClosure {
    fn csv(&self) -> String {
        let Closure { from, to, t_from_to, weight } = self.closure;
        let [from_s, to_s] = self.times_s;
        let off = t_from_to.inverse().compose(&self.finally);
        format!(
            "{from},{to},{from_s},{to_s},{},{:.4},{:.4},{:.3},{:.4},{:.3},{weight:.3},{}",
            self.closed_s,
            t_from_to.x_m,
            t_from_to.y_m,
            t_from_to.yaw_rad.to_degrees(),
            off.x_m.hypot(off.y_m),
            wrap_angle(off.yaw_rad).abs().to_degrees(),
            u8::from(self.is_held),
        )
    }
}

/// One line per closure, below the names of the columns.
pub fn csv(closures: &[ListedClosure]) -> String {
    let mut text = COLUMNS.to_owned();
    for closure in closures {
        // Writing into a String cannot fail.
        let _ = writeln!(text, "{}", closure.csv());
    }
    text
}

/// Watches a localizer and remembers when submaps began and loops were closed.
#[derive(Debug, Default)]
pub struct Closures {
    /// Time at which each submap began.
    began_s: Vec<f64>,
    accepted: u64,
    seen: Vec<(f64, Closure)>,
}

impl Closures {
    /// To be called after each update.
    pub fn observe(&mut self, time_s: f64, localizer: &Localizer) {
        while localizer.submap_in_map(self.began_s.len()).is_some() {
            self.began_s.push(time_s);
        }
        if localizer.closures() == self.accepted {
            return;
        }
        self.accepted = localizer.closures();
        for closure in localizer.held_closures() {
            if !self.seen.iter().any(|(_, seen)| is_same(seen, &closure)) {
                self.seen.push((time_s, closure));
            }
        }
    }

    /// All closures, with the final poses of their submaps. One that was dropped within the update that had accepted it is
    /// missing.
    pub fn list(&self, localizer: &Localizer) -> Vec<ListedClosure> {
        let held: Vec<Closure> = localizer.held_closures().collect();
        let listed = self.seen.iter().map(|(closed_s, seen)| {
            let last = held.iter().find(|held| is_same(held, seen));
            let closure = *last.unwrap_or(seen);
            let ends = [closure.from, closure.to];
            let [from, to] = ends.map(|index| localizer.submap_in_map(index).unwrap_or_default());
            ListedClosure {
                closure,
                times_s: ends.map(|index| self.began_s.get(index).copied().unwrap_or_default()),
                closed_s: *closed_s,
                finally: from.inverse().compose(&to),
                is_held: last.is_some(),
            }
        });
        listed.collect()
    }
}

fn is_same(one: &Closure, other: &Closure) -> bool {
    (one.from, one.to) == (other.from, other.to)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closure_is_listed_with_its_pose_and_how_far_the_final_poses_are_from_it() {
        let t_from_to = Pose2::new(1.0, 0.5, std::f64::consts::FRAC_PI_2);
        let closure = Closure { from: 3, to: 40, t_from_to, weight: 0.9 };
        let listed = ListedClosure {
            closure,
            times_s: [12.5, 99.25],
            closed_s: 101.0,
            finally: t_from_to.compose(&Pose2::new(0.03, 0.04, 0.0)),
            is_held: true,
        };
        assert_eq!(
            csv(&[listed]),
            format!("{COLUMNS}3,40,12.5,99.25,101,1.0000,0.5000,90.000,0.0500,0.000,0.900,1\n")
        );
    }
}
