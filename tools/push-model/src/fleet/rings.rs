//! Which robot is in which ring.

use super::file::Fleet;
use super::state::{FORMAT, Record, Rollout};

/// Begins a rollout. The canaries are the first ring. The other robots are ordered by a hash of their name and the model's digest,
/// so that not always the same ones are early.
#[must_use]
pub fn begin(fleet: &Fleet, digest: &str, model: &str, now_unix_s: u64) -> Rollout {
    let mut others: Vec<&str> = fleet
        .robots
        .iter()
        .filter(|robot| !robot.is_canary)
        .map(|robot| robot.name.as_str())
        .collect();
    others.sort_by_key(|name| *blake3::hash(format!("{digest} {name}").as_bytes()).as_bytes());
    let ends = ends(&fleet.rules.rings_percent, others.len());
    let ring_of = |name: &str| {
        let place = others.iter().position(|other| *other == name);
        place.map_or(0, |place| 1 + ends.iter().filter(|end| **end <= place).count())
    };
    let robots = fleet.robots.iter();
    Rollout {
        format: FORMAT,
        digest: digest.to_owned(),
        model: model.to_owned(),
        begun_unix_s: now_unix_s,
        rings: names(&fleet.rules.rings_percent),
        open: 0,
        halted: None,
        robots: robots
            .map(|robot| Record::new(&robot.name, ring_of(&robot.name), now_unix_s))
            .collect(),
    }
}

/// Where each ring ends among `robots` ordered robots. A ring has at least one robot while there are any left.
fn ends(rings_percent: &[usize], robots: usize) -> Vec<usize> {
    let mut end = 0;
    rings_percent
        .iter()
        .map(|percent| {
            end = (percent * robots).div_ceil(100).max(end + 1).min(robots);
            end
        })
        .collect()
}

fn names(rings_percent: &[usize]) -> Vec<String> {
    let others = rings_percent.iter().map(|percent| match percent {
        100 => "all".to_owned(),
        percent => format!("{percent} %"),
    });
    std::iter::once("canary".to_owned()).chain(others).collect()
}

/// Follows changes of the fleet's file during a rollout: a robot that is not in it any more is forgotten, and a new one joins the
/// last ring. A robot that the file calls a canary now is one, new or not: it may replace the only one. All others stay in their
/// ring.
pub fn follow(rollout: &mut Rollout, fleet: &Fleet, now_unix_s: u64) {
    rollout.robots.retain(|record| fleet.robot(&record.name).is_some());
    let last = rollout.rings.len() - 1;
    for robot in &fleet.robots {
        match rollout.robot_mut(&robot.name) {
            Some(record) if robot.is_canary => record.ring = 0,
            Some(_) => {}
            None => {
                let ring = if robot.is_canary { 0 } else { last };
                rollout.robots.push(Record::new(&robot.name, ring, now_unix_s));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::file::{Robot, Rules};
    use super::*;
    use crate::target::Target;

    fn fleet(canaries: usize, others: usize, rings_percent: &[usize]) -> Fleet {
        let robots = (0..canaries + others).map(|index| Robot {
            name: format!("r{index}"),
            target: Target::Local { store: format!("/r{index}") },
            is_canary: index < canaries,
        });
        let rules = Rules { rings_percent: rings_percent.to_vec(), ..Rules::default() };
        Fleet { rules, robots: robots.collect() }
    }

    fn sizes(rollout: &Rollout) -> Vec<usize> {
        let size = |ring| rollout.robots.iter().filter(|robot| robot.ring == ring).count();
        (0..rollout.rings.len()).map(size).collect()
    }

    #[test]
    fn every_robot_is_in_one_ring_and_every_ring_has_a_robot_while_there_are_any() {
        for (others, expected) in
            [(0, [2, 0, 0]), (1, [2, 1, 0]), (2, [2, 1, 1]), (10, [2, 1, 9]), (25, [2, 3, 22])]
        {
            let rollout = begin(&fleet(2, others, &[10, 100]), "digest", "student", 1);
            assert_eq!(sizes(&rollout), expected, "{others}");
            assert_eq!(rollout.flaw(), None);
        }
        for others in 0..60 {
            let sizes = sizes(&begin(&fleet(1, others, &[1, 2, 50, 100]), "d", "student", 1));
            assert_eq!(sizes.iter().sum::<usize>(), 1 + others);
            assert!(sizes.iter().skip_while(|size| **size > 0).all(|size| *size == 0), "{sizes:?}");
        }
    }

    #[test]
    fn the_early_robots_are_the_same_for_one_model_and_others_for_another() {
        let fleet = fleet(1, 40, &[10, 100]);
        let early = |digest: &str| -> Vec<String> {
            let rollout = begin(&fleet, digest, "student", 1);
            let early = rollout.robots.into_iter().filter(|robot| robot.ring == 1);
            early.map(|robot| robot.name).collect()
        };
        assert_eq!(early("one").len(), 4);
        assert_eq!(early("one"), early("one"));
        assert_ne!(early("one"), early("two"));
    }

    #[test]
    fn a_robot_that_replaces_the_only_canary_must_keep_the_model_before_the_next_ring_begins() {
        let mut rollout = begin(&fleet(1, 4, &[50, 100]), "digest", "student", 1);
        let mut changed = fleet(1, 4, &[50, 100]);
        changed.robots.remove(0);
        changed.robots[2].is_canary = true;
        follow(&mut rollout, &changed, 2);
        assert_eq!(rollout.counts(0).all, 1);
        assert!(!rollout.begin_next_ring(&changed.rules));
        assert_eq!(rollout.to_send(&changed.rules, 3), ["r3"]);
    }

    #[test]
    fn without_a_robot_in_the_open_ring_no_ring_of_canaries_is_passed() {
        let mut rollout = begin(&fleet(1, 4, &[50, 100]), "digest", "student", 1);
        rollout.robots.retain(|robot| robot.ring > 0);
        assert!(!rollout.begin_next_ring(&Rules::default()));
    }

    #[test]
    fn a_robot_that_joins_later_is_in_the_last_ring_and_one_that_left_is_forgotten() {
        let mut rollout = begin(&fleet(1, 10, &[10, 100]), "digest", "student", 1);
        let before = rollout.robots.clone();
        let mut changed = fleet(1, 12, &[50, 100]);
        changed.robots.remove(5);
        follow(&mut rollout, &changed, 2);
        assert!(rollout.robots.iter().all(|robot| robot.name != "r5"));
        let joined: Vec<usize> = rollout.robots[10..].iter().map(|robot| robot.ring).collect();
        assert_eq!(joined, [2, 2]);
        let stayed = before.into_iter().filter(|robot| robot.name != "r5");
        assert_eq!(rollout.robots[..10].to_vec(), stayed.collect::<Vec<_>>());
    }
}
