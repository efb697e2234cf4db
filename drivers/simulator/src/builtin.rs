//! Parses the names and options of built-in homes.

use crate::error::SceneError;
use crate::homes::{self, HomeKind, HomeOptions};
use crate::scene::Scene;

/// Builds the home `NAME?seed=K&texture=T&moved=M&stairs=S&cables=C`. `spec` is the whole
/// specification, for error messages.
pub(crate) fn build(spec: &str, home: &str) -> Result<Scene, SceneError> {
    let (name, query) = home.split_once('?').unwrap_or((home, ""));
    let kind: HomeKind =
        name.parse().map_err(|error: homes::UnknownHome| refuse(error.to_string(), spec))?;
    let mut options = HomeOptions::new(0);
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        let (key, value) = pair
            .split_once('=')
            .ok_or_else(|| refuse(format!("`{pair}` is not key=value"), spec))?;
        let wrong =
            |allowed: &str| refuse(format!("{key} is `{value}`, but must be {allowed}"), spec);
        match key {
            "seed" => {
                options.seed =
                    value.parse().map_err(|_| wrong("a whole number from 0 to 2^64 - 1"))?;
            }
            "texture" => {
                let texture = value.parse().ok().filter(|texture| (0.0..=1.0).contains(texture));
                options.texture = texture.ok_or_else(|| {
                    wrong("a number from 0 (blank walls) to 1 (strongly textured walls)")
                })?;
            }
            "moved" => options.moved = switch(value).ok_or_else(|| wrong("0 or 1"))?,
            "stairs" => options.stairs = switch(value).ok_or_else(|| wrong("0 or 1"))?,
            "cables" => options.cables = switch(value).ok_or_else(|| wrong("0 or 1"))?,
            _ => {
                let options = "seed, texture, moved, stairs and cables";
                let problem = format!("unknown option `{key}`; the options are {options}");
                return Err(refuse(problem, spec));
            }
        }
    }
    Ok(homes::build(kind, &options).scene)
}

fn switch(value: &str) -> Option<bool> {
    match value {
        "0" | "false" => Some(false),
        "1" | "true" => Some(true),
        _ => None,
    }
}

fn refuse(problem: String, spec: &str) -> SceneError {
    SceneError::Builtin { spec: spec.into(), problem }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(home: &str) -> String {
        build("the spec", home).unwrap_err().to_string()
    }

    #[test]
    fn a_name_with_and_without_options_builds_a_home() {
        let plain = build("", "apartment").unwrap();
        let same = build("", "apartment?seed=0&moved=0&cables=0").unwrap();
        let other = build("", "apartment?seed=1").unwrap();
        assert!(plain == same && plain != other);
    }

    #[test]
    fn a_wrong_name_key_or_value_is_refused_with_what_is_allowed() {
        assert!(refusal("castle").contains("apartment, house and office"));
        assert!(refusal("house?rooms=3").contains("seed, texture, moved, stairs and cables"));
        assert!(refusal("house?seed=-1").contains("whole number"));
        assert!(refusal("house?texture=nan").contains("from 0"));
        assert!(refusal("house?moved=maybe").contains("0 or 1"));
        assert!(refusal("house?stairs=2").contains("0 or 1"));
        assert!(refusal("house?cables=2").contains("0 or 1"));
        assert!(refusal("house?seed").contains("key=value"));
    }
}
