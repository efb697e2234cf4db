//! Errors over all robots, one row for each parameter.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use firmware_host::calibrate::{Finding, Parameter, Verdict};
use firmware_host::config::Config;

use crate::truth;

/// What became of one parameter of one robot.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Outcome {
    seed: u64,
    /// Error of the configuration, and of the measurement.
    before: f64,
    error: f64,
    sigma: f64,
    is_observed: bool,
}

/// The outcomes of all simulated robots, by parameter.
#[derive(Debug, Default)]
pub struct Trials {
    outcomes: BTreeMap<Parameter, Vec<Outcome>>,
}

impl Trials {
    pub fn add(&mut self, seed: u64, config: &Config, findings: &[Finding]) {
        for finding in findings {
            let truth = truth::value(config, finding.parameter);
            self.outcomes.entry(finding.parameter).or_default().push(Outcome {
                seed,
                before: finding.old - truth,
                error: finding.new - truth,
                sigma: finding.sigma,
                is_observed: finding.verdict() != Verdict::NotObserved,
            });
        }
    }

    /// The table in Markdown.
    pub fn table(&self) -> String {
        let mut text = "| parameter | observed | error before p90 | error p50 | error p90 | standard deviation p50 | within 2 of them |\n\
                        |---|---|---|---|---|---|---|\n"
            .to_owned();
        for (parameter, outcomes) in &self.outcomes {
            // Writing into a String cannot fail.
            let _ = writeln!(text, "{}", row(*parameter, outcomes));
        }
        text
    }

    /// Every outcome as JSON.
    pub fn json(&self) -> String {
        let mut rows = Vec::new();
        for (parameter, outcomes) in &self.outcomes {
            for outcome in outcomes {
                rows.push(serde_json::json!({
                    "parameter": parameter.nature().name,
                    "robot": outcome.seed,
                    "before": outcome.before,
                    "error": outcome.error,
                    "sigma": outcome.sigma,
                    "observed": outcome.is_observed,
                }));
            }
        }
        format!("{:#}\n", serde_json::Value::Array(rows))
    }
}

fn row(parameter: Parameter, outcomes: &[Outcome]) -> String {
    let nature = parameter.nature();
    let observed: Vec<&Outcome> = outcomes.iter().filter(|outcome| outcome.is_observed).collect();
    let errors: Vec<f64> = observed.iter().map(|outcome| outcome.error.abs()).collect();
    let before: Vec<f64> = outcomes.iter().map(|outcome| outcome.before.abs()).collect();
    let sigmas: Vec<f64> = observed.iter().map(|outcome| outcome.sigma).collect();
    let covered =
        observed.iter().filter(|outcome| outcome.error.abs() <= 2.0 * outcome.sigma).count();
    format!(
        "| {} | {} of {} | {} | {} | {} | {} | {covered} of {} |",
        nature.name,
        observed.len(),
        outcomes.len(),
        quantile(before, 0.9, parameter),
        quantile(errors.clone(), 0.5, parameter),
        quantile(errors, 0.9, parameter),
        quantile(sigmas, 0.5, parameter),
        observed.len()
    )
}

fn quantile(values: Vec<f64>, share: f64, parameter: Parameter) -> String {
    let (scale, unit) = shown(parameter);
    match percentile(values, share) {
        Some(value) => format!("{:.3}{unit}", scale * value),
        None => String::new(),
    }
}

/// Scale and unit in which errors of a parameter are shown.
fn shown(parameter: Parameter) -> (f64, &'static str) {
    match parameter {
        Parameter::LeftRadius | Parameter::RightRadius | Parameter::FocalLength => (100.0, " %"),
        Parameter::Track => (100.0 / Config::default().devices.base.track_m, " %"),
        _ => match parameter.nature().unit {
            "m" => (1000.0, " mm"),
            "deg" => (1.0, " deg"),
            _ => (1.0, " ms"),
        },
    }
}

/// The value that this share of the values does not exceed.
fn percentile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let rank = (share * values.len() as f64).ceil() as usize;
    values.get(rank.saturating_sub(1)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_percentile_is_a_value_that_was_measured() {
        let values: Vec<f64> = (1..=10).map(f64::from).collect();
        assert_eq!(percentile(values.clone(), 0.9), Some(9.0));
        assert_eq!(percentile(values, 0.5), Some(5.0));
        assert_eq!(percentile(Vec::new(), 0.5), None);
    }

    #[test]
    fn only_observed_parameters_count_as_errors() {
        let config = truth::robot(1);
        let truth = truth::value(&config, Parameter::LidarYaw);
        let seen =
            Finding { parameter: Parameter::LidarYaw, old: 0.0, new: truth + 0.1, sigma: 0.06 };
        let unseen = Finding { new: truth + 9.0, sigma: 20.0, ..seen };
        let mut trials = Trials::default();
        trials.add(1, &config, &[seen]);
        trials.add(2, &config, &[unseen]);
        let table = trials.table();
        assert!(table.contains("| LiDAR's yaw | 1 of 2 |"), "{table}");
        assert!(table.contains("| 0.100 deg | 0.100 deg | 0.060 deg | 1 of 1 |"), "{table}");
    }
}
