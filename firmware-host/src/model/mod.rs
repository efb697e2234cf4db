//! `firmware-host model`: signed models on a robot. The runtime's `model_gate` decides; here are the files, the processes and the
//! clock.
//!
//! | file | what it does |
//! |---|---|
//! | `gate.rs` | installing, step by step |
//! | `child.rs`, `examine.rs` | the process in which a model runs for the first time, from both sides |
//! | `evidence.rs` | held-out pictures out of recordings |
//! | `store.rs`, `disk.rs`, `history.rs` | models on the disk |
//! | `live.rs` | models that come while the robot drives; trial and rollback |
//! | `command.rs` | the command line |

mod child;
mod command;
mod disk;
mod error;
mod evidence;
mod examine;
mod gate;
mod history;
mod live;
mod store;
#[cfg(test)]
mod store_tests;

pub use child::ChildLimits;
pub use command::{ExamineArgs, ModelArgs, ModelCommand, run};
pub use disk::{RealDisk, StoreDisk};
pub use error::{StoreError, StoreErrorKind};
pub use examine::Unfit;
pub use gate::{Gate, Outcome, Refusal};
pub use history::{Entry, History, What};
pub use live::{Keeper, LiveModels, Start, Swap};
pub use store::{State, Store};
