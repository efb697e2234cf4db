//! The tables of stops in `docs/faults.md`, made from the table that the safety plane uses, and the classes of the faults there.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use runtime::event::{Event, PlanRefusal, SafetyEvent};
use runtime::recording::{fault_reason, sentence};
use runtime::safety::{Restart, STOPS};

const COMMAND: &str = "UPDATE_EXPECT=1 cargo test -p firmware-host stops_reference";
const BEGIN: &str = "<!-- begin of the generated table -->\n";
const END: &str = "<!-- end of the generated table -->\n";
const BEGIN_OTHERS: &str = "<!-- begin of the generated table of other stops -->\n";
const END_OTHERS: &str = "<!-- end of the generated table of other stops -->\n";
/// The class of a stop that only a person ends, and of one that ends on evidence, in the table of reactions.
const PERSON: &str = "**a person**";
const AUTOMATIC: &str = "**automatic**";
/// Other classes there. A fault of these classes is no stop of the safety plane.
const OTHER_CLASSES: [&str; 3] = ["**no stop**", "**a restart**", "**each its own**"];

/// A stop that is no [`FaultReason`](runtime::event::FaultReason): all of them end without a person.
struct OtherStop {
    event: Event,
    condition: &'static str,
    end: &'static str,
    tests: &'static str,
}

fn other_stops() -> [OtherStop; 5] {
    [
        OtherStop {
            event: Event::StandsWithoutFrames,
            condition: "the camera sends no frame for `run.frame_timeout_s` (1 s)",
            end: "the next frame; not slowly at first",
            tests: "`faults::without_a_camera_the_robot_says_so_in_every_tick_and_stands_after_a_second_until_it_is_back`, \
                    `run::it_explores_stands_while_a_device_is_gone_says_so_and_goes_on_without_help`",
        },
        OtherStop {
            event: Event::Safety { what: SafetyEvent::PlanRefused { why: PlanRefusal::Stale } },
            condition: "the plan is missing, is not finite, or is older than `run.plan_timeout_s` (0.5 s)",
            end: "the next valid plan; not slowly at first",
            tests: "`plane::a_nan_or_old_or_missing_plan_stops_the_robot_and_the_reason_is_reported_once`, \
                    `run::while_the_planner_hangs_the_robot_stands_sigusr2_stops_it_and_sigterm_releases_the_motors`",
        },
        OtherStop {
            event: Event::Safety { what: SafetyEvent::ViewLost },
            condition: "the scanner has not seen the path ahead for 0.3 s",
            end: "the scanner sees it again, or the plan leads elsewhere",
            tests: "`faults::dirt_before_the_scanner_stops_the_robot_within_15_centimetres_and_it_goes_on_without_it`, \
                    `run::dirt_before_the_scanner_stops_the_robot_until_it_is_gone`",
        },
        OtherStop {
            event: Event::StandsLost,
            condition: "the robot is lost, has rotated twice without recognizing the place, and does not begin another map: it has a task \
                        or returns to its start, there are areas to keep in or out of, it has four maps, or `localization.new_map_when_lost` is off",
            end: "it recognizes the place, also because it was moved; a person lets it explore, or opens the areas",
            tests: "`separate_maps_tests::a_robot_that_may_not_begin_another_map_stands`, \
                    `separate_maps_tests::a_robot_with_a_task_or_with_closed_areas_of_its_map_begins_no_other`",
        },
        OtherStop {
            event: Event::StandsTilted { tilt_deg: 15.0 },
            condition: "an accelerometer in `[devices.imu]` measures a tilt above `localization.most_tilt_deg` (10 degrees)",
            end: "a tilt of 3 degrees less, or no sample for a second",
            tests: "`tilt::tests::a_tilted_robot_stands_and_maps_nothing_until_it_is_level`",
        },
    ]
}

fn table() -> String {
    let mut out = String::new();
    let _ = writeln!(out, "This table is generated from the source code by `{COMMAND}`.\n");
    let _ = writeln!(out, "| reason in `health` | condition | what ends the stop | tests |");
    let _ = writeln!(out, "|---|---|---|---|");
    for stop in &STOPS {
        let end = match stop.restart {
            Restart::Person => PERSON.to_owned(),
            Restart::Evidence(evidence) => format!("{evidence}; slow for 1 s"),
        };
        let why = fault_reason(stop.why);
        let _ = writeln!(out, "| {why} | {} | {end} | {} |", stop.condition, stop.tests);
    }
    out
}

fn table_of_others() -> String {
    let mut out = String::new();
    let _ = writeln!(out, "| in the log | condition | what ends the stop | tests |");
    let _ = writeln!(out, "|---|---|---|---|");
    for OtherStop { event, condition, end, tests } in other_stops() {
        let (_, text) = sentence(&event);
        let _ = writeln!(out, "| {text} | {condition} | {end} | {tests} |");
    }
    out
}

fn path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/faults.md")
}

/// The text with what is between `begin` and `end` replaced.
fn with_part(text: &str, [begin, end]: [&str; 2], part: &str) -> String {
    let (before, rest) = text.split_once(begin).unwrap();
    let (_, after) = rest.split_once(end).unwrap();
    [before, begin, part, end, after].concat()
}

#[test]
fn the_tables_of_stops_in_the_documentation_are_those_that_the_robot_uses() {
    let committed = std::fs::read_to_string(path()).unwrap();
    let generated = with_part(&committed, [BEGIN, END], &table());
    let generated = with_part(&generated, [BEGIN_OTHERS, END_OTHERS], &table_of_others());
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        std::fs::write(path(), generated).unwrap();
        return;
    }
    assert!(committed == generated, "docs/faults.md is not up to date; remake it with {COMMAND}");
}

/// The table of reactions: what fails and the reaction, whose first words are the class.
fn reactions(text: &str) -> Vec<(&str, &str)> {
    let (_, table) =
        text.split_once("| what fails | reaction | limit | simulated | rig |\n").unwrap();
    let rows = table.lines().skip(1).take_while(|line| line.starts_with("| "));
    rows.map(|row| {
        let mut cells = row.trim_start_matches("| ").split(" | ");
        (cells.next().unwrap(), cells.next().unwrap())
    })
    .collect()
}

/// The reason in `health` after a class: `**a person** (REASON): `.
fn stop_after<'a>(reaction: &'a str, class: &str) -> Option<&'a str> {
    let (reason, _) = reaction.strip_prefix(class)?.strip_prefix(" (")?.split_once("): ")?;
    Some(reason)
}

#[test]
fn every_fault_in_the_documentation_has_a_class_and_it_is_that_of_its_stop_in_the_code() {
    let text = std::fs::read_to_string(path()).unwrap();
    let reactions = reactions(&text);
    for (fault, reaction) in &reactions {
        let classes = OTHER_CLASSES.iter().chain([&PERSON, &AUTOMATIC]);
        let known = classes.filter(|class| reaction.starts_with(**class)).count();
        assert_eq!(known, 1, "{fault}: {reaction} begins with no class");
    }
    for stop in &STOPS {
        let is_person = stop.restart == Restart::Person;
        let [right, wrong] = if is_person { [PERSON, AUTOMATIC] } else { [AUTOMATIC, PERSON] };
        let rows_of = |class: &str| {
            let named = reactions.iter().filter_map(|(_, reaction)| stop_after(reaction, class));
            named.filter(|reason| *reason == fault_reason(stop.why)).count()
        };
        assert!(rows_of(right) > 0, "no fault of the class {right} leads to {:?}", stop.why);
        assert_eq!(rows_of(wrong), 0, "{:?} is not of the class {wrong}", stop.why);
    }
}

#[test]
fn every_reason_that_the_documentation_names_is_that_of_a_stop_in_the_code() {
    let text = std::fs::read_to_string(path()).unwrap();
    for (fault, reaction) in reactions(&text) {
        let named = [PERSON, AUTOMATIC].iter().find_map(|class| stop_after(reaction, class));
        let is_known =
            named.is_none_or(|reason| STOPS.iter().any(|stop| fault_reason(stop.why) == reason));
        assert!(is_known, "{fault}: no stop has the reason {named:?}");
    }
}
