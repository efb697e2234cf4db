//! The names of built-in homes.

use crate::error::SceneError;
use crate::scene::Scene;

/// Builds `NAME?seed=K&texture=T&moved=M`; `spec` is the whole, for messages.
pub(crate) fn build(spec: &str, _home: &str) -> Result<Scene, SceneError> {
    Err(SceneError::Builtin { spec: spec.into(), problem: "there are no built-in homes yet".into() })
}
