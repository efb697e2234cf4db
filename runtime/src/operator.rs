//! An operator's order as it is recorded. What it does is elsewhere: a [`Task`](crate::task::Task) is an input of the tick too,
//! and orders to the safety plane reach it through the control panel.

use serde::{Deserialize, Serialize};

/// What a client of the live view may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// See everything, and stop the robot.
    Watch,
    /// Also arm, pause and send the robot.
    Steer,
}

impl Role {
    /// The role's name in tokens and messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Watch => "watch",
            Self::Steer => "steer",
        }
    }
}

/// An order that came to the robot from outside, accepted or refused.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OperatorOrder {
    /// The client, as far as it is known: its address and the name of its token.
    pub who: String,
    /// What the client may do; `None` if the order could not be read.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub role: Option<Role>,
    /// The order in words.
    pub what: String,
    /// Why it was refused; `None` if it was accepted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub refused: Option<String>,
}

impl OperatorOrder {
    /// The order as a sentence for a log.
    #[must_use]
    pub fn sentence(&self) -> String {
        let Self { who, role, what, refused } = self;
        let role = role.map_or_else(String::new, |role| format!(" ({})", role.name()));
        match refused {
            None => format!("order of {who}{role}: {what}"),
            Some(why) => format!("order of {who}{role} refused: {what}: {why}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sentence_names_client_role_order_and_the_reason_of_a_refusal() {
        let order = OperatorOrder {
            who: "127.0.0.1:4000".to_owned(),
            role: Some(Role::Watch),
            what: "arm".to_owned(),
            refused: Some("this client may only watch".to_owned()),
        };
        assert_eq!(
            order.sentence(),
            "order of 127.0.0.1:4000 (watch) refused: arm: this client may only watch"
        );
        let accepted = OperatorOrder { role: None, refused: None, ..order };
        assert_eq!(accepted.sentence(), "order of 127.0.0.1:4000: arm");
    }
}
