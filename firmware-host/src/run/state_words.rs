//! The states of the safety plane in words.

use runtime::recording::fault_reason;
use runtime::safety::SafetyState;

/// The state's name; for a fault, its reason as well.
pub fn state_words(state: &SafetyState) -> String {
    match state {
        SafetyState::Fault(why) => format!("fault: {}", fault_reason(*why)),
        state => state.name().to_owned(),
    }
}
