//! The people and pets of a home: what the sensors see of them, and what blocks the robot.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::{PEOPLE_STREAM, PETS_STREAM, stream_rng};
use crate::body::Capsule;
use crate::floor::{Disc, FloorPlan};
use crate::nuisance::Nuisances;
use crate::people::{Person, Walker};
use crate::pets::{Pet, PetWalker};

/// Walking speed of people indoors, m/s.
const WALKING_MPS: f64 = 0.8;
/// Number of waypoints of a path, and how many random positions are tried for them.
const WAYPOINTS: usize = 4;
const WAYPOINT_TRIES: usize = 200;
/// Half the width of a person, metres. Paths of pets keep this distance as well.
const PERSON_RADIUS_M: f64 = 0.25;

/// Everything that walks about in a home.
pub(super) struct Inhabitants {
    pub people: Vec<Walker>,
    pub pets: Vec<PetWalker>,
}

impl Inhabitants {
    /// People and pets have random streams of their own, so that one more pet changes no person.
    pub fn new(plan: &FloorPlan, nuisances: &Nuisances, seed: u64) -> Self {
        let mut rng = stream_rng(PEOPLE_STREAM, seed);
        let people = (0..nuisances.people)
            .filter_map(|_| Walker::new(waypoints(plan, &mut rng), WALKING_MPS, rng.random()))
            .collect();
        let mut rng = stream_rng(PETS_STREAM, seed);
        let pets = (0..nuisances.pets)
            .filter_map(|_| PetWalker::new(waypoints(plan, &mut rng), rng.random()))
            .collect();
        Self { people, pets }
    }

    /// What camera and scanner see.
    pub fn bodies(&self, time_ns: u64) -> Vec<Capsule> {
        let people = self.people(time_ns).flat_map(|person| person.body());
        let pets = self.pets(time_ns).flat_map(|pet| pet.body());
        people.chain(pets).collect()
    }

    /// What blocks the base.
    pub fn discs(&self, time_ns: u64) -> Vec<Disc> {
        let people = self.people(time_ns).map(|person| person_disc(&person));
        let pets = self.pets(time_ns).flat_map(|pet| pet.discs());
        people.chain(pets).collect()
    }

    fn people(&self, time_ns: u64) -> impl Iterator<Item = Person> {
        self.people.iter().map(move |walker| walker.at(time_ns))
    }

    fn pets(&self, time_ns: u64) -> impl Iterator<Item = Pet> {
        self.pets.iter().map(move |walker| walker.at(time_ns))
    }
}

fn person_disc(person: &Person) -> Disc {
    Disc { center_m: person.position_m, radius_m: PERSON_RADIUS_M }
}

/// Free positions with a line of sight between consecutive ones, metres.
fn waypoints(plan: &FloorPlan, rng: &mut Pcg64Mcg) -> Vec<[f64; 2]> {
    let mut path: Vec<[f64; 2]> = Vec::new();
    for _ in 0..WAYPOINT_TRIES {
        let place = plan.random_pose(rng.random());
        let place = [place.x_m, place.y_m];
        if path.last().is_none_or(|last| is_clear(*last, place, plan)) {
            path.push(place);
        }
        if path.len() == WAYPOINTS {
            break;
        }
    }
    path
}

/// Whether a person fits everywhere on the straight line between two positions.
fn is_clear(a: [f64; 2], b: [f64; 2], plan: &FloorPlan) -> bool {
    let steps = ((a[0] - b[0]).hypot(a[1] - b[1]) / 0.05).ceil().max(1.0) as usize;
    (0..=steps).all(|step| {
        let share = step as f64 / steps as f64;
        plan.clearance_m(a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))
            > PERSON_RADIUS_M
    })
}
