//! Passes over simulated robots: what they are sent, in which order, and when it stops.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::sync::Mutex;

use anyhow::{Result, bail};

use super::answer::{Event, Judged, Listed, Trial, What};
use super::file::{Fleet, Robot, Rules};
use super::pass::Pass;
use super::rings;
use super::robots::{Asked, Robots, Sent};
use super::rollout::Standing;
use super::state::{Rollout, Verdict};
use crate::target::Target;

/// What a simulated robot makes of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Plan {
    Keeps,
    Refuses,
    RollsBack,
    IsUnreachable,
    /// It keeps the model, and its answer is lost on the way.
    LosesAnswer,
    /// The connection breaks before it has the model, every time.
    BreaksOff,
}

/// A robot's store.
#[derive(Debug, Default)]
struct Store {
    listed: Listed,
    /// How many times it was sent the model.
    sent: usize,
}

struct Simulated {
    plans: BTreeMap<String, Plan>,
    stores: Mutex<BTreeMap<String, Store>>,
}

impl Simulated {
    fn new(plans: &[Plan]) -> Self {
        let plans = plans.iter().enumerate();
        Self {
            plans: plans.map(|(index, plan)| (format!("r{index}"), *plan)).collect(),
            stores: Mutex::default(),
        }
    }

    fn with<T>(&self, name: &str, change: impl FnOnce(&mut Store) -> T) -> T {
        let mut stores = self.stores.lock().unwrap();
        change(stores.entry(name.to_owned()).or_default())
    }

    fn add(&self, name: &str, current: Option<Trial>, what: What, why: &str) {
        self.with(name, |store| {
            store.listed.current = current;
            store.listed.events.push(Event { what, why: why.to_owned() });
        });
    }

    /// The robots drive until all trials have ended.
    fn end_trials(&self) {
        for (name, plan) in &self.plans {
            if self.with(name, |store| store.listed.current) != Some(Trial::Runs) {
                continue;
            }
            match plan {
                Plan::RollsBack => self.add(name, None, What::RolledBack, "it hit the bumper"),
                _ => self.add(name, Some(Trial::Ended), What::Kept, "kept after 600 ticks"),
            }
        }
    }

    fn sent(&self) -> Vec<String> {
        let stores = self.stores.lock().unwrap();
        let sent = stores.iter().flat_map(|(name, store)| vec![name.clone(); store.sent]);
        sent.collect()
    }
}

impl Robots for Simulated {
    fn ask(&self, name: &str) -> Asked {
        match self.plans[name] {
            Plan::IsUnreachable => Asked::Unreachable { why: "no route to host".to_owned() },
            _ => Asked::Listed(self.with(name, |store| store.listed.clone())),
        }
    }

    fn send(&self, name: &str) -> Sent {
        self.with(name, |store| store.sent += 1);
        let why = "connection reset".to_owned();
        match self.plans[name] {
            Plan::Refuses => {
                self.add(name, None, What::Refused, "too slow");
                Sent::Judged(Judged::Refused { why: "judged: too slow".to_owned() })
            }
            Plan::BreaksOff => Sent::NotArrived { why },
            Plan::LosesAnswer => {
                self.add(name, Some(Trial::Runs), What::Installed, "");
                Sent::Unknown { why }
            }
            Plan::Keeps | Plan::RollsBack | Plan::IsUnreachable => {
                self.add(name, Some(Trial::Runs), What::Installed, "");
                Sent::Judged(Judged::Accepted)
            }
        }
    }
}

/// A rollout whose state is kept on a simulated disk.
struct Scene {
    robots: Simulated,
    rules: Rules,
    disk: RefCell<Rollout>,
    now_unix_s: Cell<u64>,
    /// After this number of writes, all others fail, as if the program was ended.
    writes_left: Cell<usize>,
    parallel: usize,
}

impl Scene {
    /// A fleet of which the first robots are canaries.
    fn new(canaries: usize, plans: &[Plan], rules: Rules) -> Self {
        let robots = (0..plans.len()).map(|index| Robot {
            name: format!("r{index}"),
            target: Target::Local { store: format!("/r{index}") },
            is_canary: index < canaries,
        });
        let fleet = Fleet { rules: rules.clone(), robots: robots.collect() };
        Self {
            robots: Simulated::new(plans),
            rules,
            disk: RefCell::new(rings::begin(&fleet, "digest", "student", 0)),
            now_unix_s: Cell::new(1000),
            writes_left: Cell::new(usize::MAX),
            parallel: 1,
        }
    }

    fn pass(&self) -> Result<()> {
        let mut rollout = self.disk.borrow().clone();
        self.now_unix_s.set(self.now_unix_s.get() + 60);
        let save = |rollout: &Rollout| {
            let Some(left) = self.writes_left.get().checked_sub(1) else { bail!("ended") };
            self.writes_left.set(left);
            self.disk.replace(rollout.clone());
            Ok(())
        };
        let pass = Pass {
            robots: &self.robots,
            rules: &self.rules,
            parallel: self.parallel,
            now_unix_s: &|| self.now_unix_s.get(),
            save: &save,
            tell: &|_| (),
        };
        pass.run(&mut rollout)
    }

    /// Passes, between which trials end, until nothing changes any more.
    fn pass_until_still(&self) {
        let mut before = None;
        while before != Some(self.disk.borrow().clone()) {
            before = Some(self.disk.borrow().clone());
            self.pass().unwrap();
            self.robots.end_trials();
        }
    }

    fn standing(&self) -> Standing {
        self.disk.borrow().standing()
    }

    fn ring(&self, ring: usize) -> Vec<String> {
        let rollout = self.disk.borrow();
        let mut names: Vec<String> = rollout
            .robots
            .iter()
            .filter(|robot| robot.ring == ring)
            .map(|robot| robot.name.clone())
            .collect();
        names.sort();
        names
    }

    fn verdict(&self, name: &str) -> Verdict {
        self.disk.borrow_mut().robot_mut(name).unwrap().verdict
    }

    fn why_halted(&self) -> String {
        self.disk.borrow().halted.clone().unwrap().why
    }
}

fn halves() -> Rules {
    Rules { rings_percent: vec![50, 100], ..Rules::default() }
}

#[test]
fn rings_begin_one_after_the_other_when_every_robot_has_kept_the_model() {
    let scene = Scene::new(1, &[Plan::Keeps; 5], halves());
    scene.pass().unwrap();
    assert_eq!(scene.robots.sent(), ["r0"]);
    scene.pass().unwrap();
    assert_eq!(scene.robots.sent(), ["r0"], "the trial of the canary has not ended");
    scene.robots.end_trials();
    scene.pass().unwrap();
    let mut expected = [vec!["r0".to_owned()], scene.ring(1)].concat();
    assert_eq!(scene.robots.sent(), expected);
    scene.robots.end_trials();
    scene.pass().unwrap();
    expected.extend(scene.ring(2));
    expected.sort();
    assert_eq!(scene.robots.sent(), expected);
    assert_eq!(scene.standing(), Standing::Waiting);
    scene.robots.end_trials();
    scene.pass().unwrap();
    assert_eq!(scene.standing(), Standing::Complete);
    scene.pass().unwrap();
    assert_eq!(scene.robots.sent(), expected);
}

#[test]
fn a_canary_that_refuses_or_rolls_back_halts_and_nothing_else_is_sent() {
    for plan in [Plan::Refuses, Plan::RollsBack] {
        let mut plans = [Plan::Keeps; 6];
        plans[1] = plan;
        let scene = Scene::new(2, &plans, halves());
        scene.pass_until_still();
        assert_eq!(scene.standing(), Standing::Halted, "{plan:?}");
        assert_eq!(scene.robots.sent(), ["r0", "r1"]);
        let why = scene.why_halted();
        assert!(
            why.contains("1 of 2") && why.contains("r1 (") && why.contains("allowed: 0"),
            "{why}"
        );
        assert!(why.contains("too slow") || why.contains("it hit the bumper"), "{why}");
    }
}

#[test]
fn a_resumed_rollout_goes_on_and_the_robots_that_failed_count_no_more() {
    let mut plans = [Plan::Keeps; 5];
    plans[0] = Plan::Refuses;
    let scene = Scene::new(1, &plans, halves());
    scene.pass_until_still();
    assert_eq!(scene.robots.sent(), ["r0"]);
    scene.disk.borrow_mut().resume();
    scene.pass_until_still();
    assert_eq!(scene.standing(), Standing::Complete);
    assert_eq!(scene.robots.sent(), ["r0", "r1", "r2", "r3", "r4"]);
    assert_eq!(scene.verdict("r0"), Verdict::Refused);
}

#[test]
fn a_later_ring_tolerates_failures_within_its_share_and_halts_beyond_it() {
    for (failures, standing) in [(2, Standing::Complete), (3, Standing::Halted)] {
        let mut plans = vec![Plan::Keeps; 21];
        plans[1..=failures].fill(Plan::RollsBack);
        let rules = Rules { rings_percent: vec![100], ..Rules::default() };
        let scene = Scene::new(1, &plans, rules);
        scene.pass_until_still();
        assert_eq!(scene.standing(), standing, "{failures} of 20");
    }
}

#[test]
fn sending_stops_in_the_middle_of_a_ring_that_cannot_stay_within_its_share() {
    let mut plans = vec![Plan::Refuses; 41];
    plans[0] = Plan::Keeps;
    let rules = Rules { rings_percent: vec![100], ..Rules::default() };
    let mut scene = Scene::new(1, &plans, rules);
    scene.pass_until_still();
    // Of 40 robots, four may refuse: the fifth refusal ends it.
    assert_eq!((scene.standing(), scene.robots.sent().len()), (Standing::Halted, 1 + 5));
    scene = Scene { parallel: 8, ..Scene::new(1, &plans, scene.rules.clone()) };
    scene.pass_until_still();
    assert!(scene.robots.sent().len() <= 1 + 5 + 7, "what was on its way arrives");
}

#[test]
fn a_robot_that_is_not_reached_is_reported_and_sent_the_model_when_it_is_back() {
    let mut plans = [Plan::Keeps; 5];
    plans[4] = Plan::IsUnreachable;
    let mut scene = Scene::new(2, &plans, Rules { rings_percent: vec![100], ..Rules::default() });
    scene.pass_until_still();
    assert_eq!(scene.standing(), Standing::Waiting);
    assert_eq!(scene.robots.sent(), ["r0", "r1", "r2", "r3"]);
    let problem = scene.disk.borrow().robots[4].problem.clone();
    assert_eq!(problem.as_deref(), Some("no route to host"));
    scene.robots.plans.insert("r4".to_owned(), Plan::Keeps);
    scene.pass_until_still();
    assert_eq!(scene.standing(), Standing::Complete);
}

#[test]
fn a_share_of_a_ring_may_be_enough_for_the_next_one_to_begin() {
    let mut plans = [Plan::Keeps; 11];
    let rules = Rules { kept_percent: 80, ..halves() };
    let early = Scene::new(1, &plans, rules.clone()).ring(1);
    let index: usize = early[0][1..].parse().unwrap();
    plans[index] = Plan::IsUnreachable;
    let scene = Scene::new(1, &plans, rules);
    scene.pass_until_still();
    assert_eq!(scene.robots.sent().len(), 10, "four of five robots are 80 %");
    let strict = Scene::new(1, &plans, halves());
    strict.pass_until_still();
    assert_eq!(strict.robots.sent().len(), 5);
}

#[test]
fn a_late_rollback_in_an_early_ring_halts_the_later_ones() {
    let scene = Scene::new(1, &[Plan::Keeps; 5], halves());
    scene.pass().unwrap();
    scene.robots.end_trials();
    scene.pass().unwrap();
    scene.robots.end_trials();
    scene.robots.add("r0", None, What::RolledBack, "rolled back by an operator");
    scene.pass().unwrap();
    assert_eq!(scene.standing(), Standing::Halted);
    assert_eq!(scene.robots.sent().len(), 3);
    assert!(scene.why_halted().contains("by an operator"));
}

#[test]
fn a_lost_answer_is_found_in_the_robots_list_and_a_model_that_did_not_arrive_is_sent_again() {
    let scene = Scene::new(2, &[Plan::LosesAnswer, Plan::BreaksOff], halves());
    scene.pass().unwrap();
    assert_eq!((scene.verdict("r0"), scene.verdict("r1")), (Verdict::Sent, Verdict::Waiting));
    scene.pass().unwrap();
    assert_eq!(scene.verdict("r0"), Verdict::OnTrial);
    assert_eq!(scene.robots.sent(), ["r0", "r1", "r1"]);
}

#[test]
fn a_robot_without_an_answer_is_sent_the_model_again_only_when_it_cannot_be_judging_it_any_more() {
    let scene = Scene::new(1, &[Plan::Keeps], halves());
    // Sending was on the disk, and nothing arrived.
    scene.disk.borrow_mut().robots[0].verdict = Verdict::Sent;
    scene.disk.borrow_mut().robots[0].unix_s = 1000;
    scene.disk.borrow_mut().robots[0].entries_before = Some(0);
    for _ in 0..29 {
        scene.pass().unwrap();
    }
    assert!(scene.robots.sent().is_empty());
    scene.pass().unwrap();
    assert_eq!(scene.robots.sent(), ["r0"]);
}

#[test]
fn a_robot_that_uses_the_model_already_is_not_sent_it() {
    let scene = Scene::new(2, &[Plan::Keeps; 3], halves());
    scene.robots.add("r0", Some(Trial::Ended), What::Kept, "kept");
    scene.robots.add("r2", Some(Trial::Runs), What::Installed, "");
    scene.pass_until_still();
    assert_eq!(
        (scene.standing(), scene.robots.sent()),
        (Standing::Complete, vec!["r1".to_owned()])
    );
}

/// What must come of a fleet: ring after ring, until a robot fails or cannot be reached.
fn expected(scene: &Scene) -> (Standing, Vec<String>) {
    let mut may_be_sent = Vec::new();
    for ring in 0..3 {
        let names = scene.ring(ring);
        let has = |plan: Plan| names.iter().any(|name| scene.robots.plans[name] == plan);
        may_be_sent.extend(names.clone());
        if has(Plan::Refuses) || has(Plan::RollsBack) {
            return (Standing::Halted, may_be_sent);
        }
        if has(Plan::IsUnreachable) {
            return (Standing::Waiting, may_be_sent);
        }
    }
    (Standing::Complete, may_be_sent)
}

/// Every combination of plans for a canary and four other robots.
fn all_plans() -> impl Iterator<Item = [Plan; 5]> {
    let kinds = [Plan::Keeps, Plan::Refuses, Plan::RollsBack, Plan::IsUnreachable];
    (0..kinds.len().pow(5)).map(move |mut code| {
        [(); 5].map(|()| {
            let kind = kinds[code % kinds.len()];
            code /= kinds.len();
            kind
        })
    })
}

#[test]
fn every_small_fleet_ends_as_its_first_bad_ring_says_and_no_robot_is_sent_the_model_twice() {
    for plans in all_plans() {
        let scene = Scene::new(1, &plans, halves());
        scene.pass_until_still();
        let (standing, may_be_sent) = expected(&scene);
        assert_eq!(scene.standing(), standing, "{plans:?}");
        let sent = scene.robots.sent();
        let mut once = sent.clone();
        once.dedup();
        assert_eq!(sent, once, "{plans:?}");
        assert!(sent.iter().all(|name| may_be_sent.contains(name)), "{plans:?} {sent:?}");
    }
}

#[test]
fn a_pass_that_is_ended_at_any_write_sends_to_no_robot_twice_and_ends_the_same() {
    let fleets = [
        [Plan::Keeps; 5],
        [Plan::Keeps, Plan::LosesAnswer, Plan::Keeps, Plan::RollsBack, Plan::Keeps],
        [Plan::Refuses, Plan::Keeps, Plan::Keeps, Plan::Keeps, Plan::Keeps],
    ];
    for plans in fleets {
        for parallel in [1, 4] {
            for writes in 0..40 {
                let scene = Scene { parallel, ..Scene::new(1, &plans, halves()) };
                scene.writes_left.set(writes);
                while scene.writes_left.get() > 0 && scene.pass().is_ok() {
                    scene.robots.end_trials();
                    if scene.standing() != Standing::Waiting {
                        break;
                    }
                }
                scene.writes_left.set(usize::MAX);
                // Sending was noted, and the program ended before it: the model is due again later.
                for _ in 0..4 {
                    scene.pass_until_still();
                    scene.now_unix_s.set(scene.now_unix_s.get() + 3600);
                }
                assert_eq!(scene.standing(), expected(&scene).0, "{plans:?} {parallel} {writes}");
                let sent = scene.robots.sent();
                let mut once = sent.clone();
                once.dedup();
                assert_eq!(sent, once, "{plans:?} {parallel} {writes}");
            }
        }
    }
}
