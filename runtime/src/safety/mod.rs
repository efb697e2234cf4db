//! The safety plane: the state machine that every velocity command passes before it reaches the
//! wheels.
//!
//! It reads the safety LiDAR, the wheel feedback and the emergency stop directly, and needs neither
//! the camera nor the map. The planner's command (the plan) passes unchanged while the path is
//! clear. Near an obstacle the safety plane reduces the speed so that the robot can always stop
//! before it. When the robot comes too close, the safety plane stops it, backs off and, if that
//! does not help, rotates it towards free space.
//!
//! # States
//!
//! [`SafetyPlane::step`] is called once per control period. In each call the first matching row
//! decides:
//!
//! | from | condition | to |
//! |---|---|---|
//! | any except a fault that needs a person | [`Request::Disarm`] | `Disarmed` |
//! | `Disarmed` | the emergency stop is pressed | `Fault` |
//! | any except `Disarmed` and a fault that needs a person | a sensor, the base, the loop's timing or the emergency stop forbids motion | `Fault` |
//! | `Disarmed` | [`Request::Arm`] and enough good scans in a row | `Clear` |
//! | `Fault` that resumes on evidence ([`STOPS`]) | the reason is gone and there are enough good scans in a row | `Clear` |
//! | `Fault` that needs a person | the reason is gone and [`Request::ClearFault`] | `Disarmed` |
//! | `Clear`, `Slow` | a forward plan whose speed limit is below 0.05 m/s | `Tripped` |
//! | `Clear`, `Slow`, `Escaping` | a contact while the robot is commanded to move | `Tripped` |
//! | `Clear`, `Slow`, `BackingOff`, `Escaping` | the third contact within 30 s and 0.5 m | `Fault` |
//! | `Clear`, `Slow` | a forward plan that is faster than the speed limit | `Slow` |
//! | `Slow` | a forward plan within the speed limit | `Clear` |
//! | `Tripped` | the wheels stand still, or 0.5 s have passed | `BackingOff` |
//! | `BackingOff` | the configured distance is covered, and it was not the third trip at one place | `Clear` |
//! | `BackingOff` | it ends for any other reason: blocked or unknown ground behind, timeout, third trip | `Escaping` |
//! | `Escaping` | 0.5 m ahead are free after 45 degrees; or one full rotation, a timeout, or a corner that would collide | `Clear` |
//!
//! The speed limit of a forward plan is the lowest of these: the speed from which the robot stops
//! before the nearest obstacle on its path, or before an obstacle just beyond what it sees, within its
//! reaction time, which is longer with a slow scanner ([`SafetyConfig::top_speed_mps`]); 0.1 m/s beside an obstacle that is nearer than the
//! scanner's noise; 0.15 m/s while the scanner does not see the path ahead, and 0 after 0.3 s.
//!
//! After a fault that resumes on evidence, speeds are limited to [`CREEP_MPS`] and [`CREEP_RADPS`]
//! for [`CREEP_NS`].
//!
//! A call that enters `Clear` from `Disarmed` or `Fault` also checks the plan, so it may end in
//! `Slow` or `Tripped`. Plans have an effect in `Clear` and `Slow` only. A plan that is missing,
//! too old or not finite stops the robot without a change of state.
//!
//! # Glossary
//!
//! | term | meaning |
//! |---|---|
//! | plan | the velocity that the planner asks for, with the time of the measurements behind it |
//! | stop zone | the area ahead in which an obstacle leaves no time to stop before the configured stop distance |
//! | trip | a stop because of an obstacle in the stop zone or a contact |
//! | contact | the base reports that its bumper is pressed, that a wheel is blocked, or that a cliff sensor sees no floor |
//! | back-off | reversing from the obstacle after a trip, by a configured distance |
//! | blocked point | the place of the trip, reported to the planner when the back-off ends |
//! | escape | rotating on the spot until there is free space ahead |
//! | fault | a reason outside of the plan that forbids all motion: silent or broken sensors, the base, timing, emergency stop |
//! | known ground | ground behind the robot that it drove over or observed a moment ago, and that is therefore free |
//! | horizon | the distance from the laser within which obstacles are considered |

mod config;
mod control;
mod corridor;
mod footprint;
mod plane;
mod power;
mod rear;
mod restart;
mod sent;
mod speed;
mod state;
mod surroundings;
mod witness;

pub use config::{BodySector, SafetyConfig, SafetySection};
pub use control::{Orders, SafetyLoop, SafetyStep};
pub use footprint::Footprint;
pub use plane::SafetyPlane;
pub use restart::{CREEP_MPS, CREEP_NS, CREEP_RADPS, Restart, STOPS, Stop};
pub use sent::SentCommand;
pub use state::{BackOff, Escape, Plan, Request, SafetyInput, SafetyOutput, SafetyState};
pub use surroundings::{Obstacle, ScanHealth, Surroundings, needs_second_scan};
pub use witness::{WheelError, scanner_motion};

#[cfg(test)]
mod orders_tests;
#[cfg(test)]
mod slow_scanner_tests;
