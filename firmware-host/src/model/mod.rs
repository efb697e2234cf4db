//! `firmware-host model`: signed models on a robot. The decisions are made in the runtime's
//! `model_gate`; this module adds files, processes and time.
//!
//! | file | content |
//! |---|---|
//! | `gate.rs` | installing a model, step by step |
//! | `child.rs`, `examine.rs` | parent and child side of the process in which a model runs for the first time |
//! | `evidence.rs` | held-out frames from recordings |
//! | `store.rs`, `disk.rs`, `history.rs`, `counts.rs` | the model store on disk |
//! | `live.rs` | models that are installed while the robot drives; trial and rollback |
//! | `command.rs` | the command line |

mod child;
mod command;
mod counts;
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
pub use counts::{Counted, SavedCounts};
pub use disk::{RealDisk, StoreDisk};
pub use error::{StoreError, StoreErrorKind};
pub use examine::Unfit;
pub use gate::{Gate, Outcome, Refusal};
pub use history::{Entry, History, What};
pub use live::{Keeper, LiveModels, Start, Swap};
pub use store::{State, Store};
