//! Installing a model, in the order that lets nothing untrusted be parsed, nothing unexamined drive, and nothing half-done stay:
//! signature, examination in a process of its own, judgement, store.

use std::path::{Path, PathBuf};

use anyhow::Result;
use runtime::model_gate::{Examination, GateLimits, Verdict, Why, judge};
use signed_model::{Bundle, BundleError, Signed, TrustedKeys};

use super::child::{ChildLimits, Ended, Task, examine};
use super::examine::Unfit;
use super::history::{Entry, What};
use super::store::Store;

/// How a model is installed.
#[derive(Debug, Clone)]
pub struct Gate {
    /// This program, which examines.
    pub program: PathBuf,
    /// The robot's configuration.
    pub config: Option<PathBuf>,
    /// Where held-out pictures are found.
    pub recordings: Vec<PathBuf>,
    /// Held-out pictures at most.
    pub frames: usize,
    /// What the examination may use.
    pub child: ChildLimits,
    /// What is asked of a model.
    pub limits: GateLimits,
    /// Whether a first model may come without held-out pictures.
    pub unproven: bool,
    /// Whether a model that was rolled back may be tried once more.
    pub again: bool,
    /// Whether the examination uses only otherwise idle time.
    pub idle: bool,
}

/// Why a model is not taken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The signature.
    #[error(transparent)]
    Signature(#[from] BundleError),
    /// It was rolled back before.
    #[error(
        "it was rolled back before ({why}); train another one, or try it once more with --again"
    )]
    RolledBackBefore {
        /// Why, then.
        why: String,
    },
    /// It is what drives already.
    #[error("it is the current model already")]
    Current,
    /// It cannot be the robot's depth network.
    #[error(transparent)]
    Unfit(#[from] Unfit),
    /// It ended the process that examined it.
    #[error(
        "the process that examined it did not live ({doing}): {how}; a model of this robot needs less memory and time"
    )]
    Died {
        /// What the process was doing.
        doing: String,
        /// How it ended.
        how: String,
    },
    /// It is worse, slower or not shown to be as good.
    #[error("{}", .0.refused.iter().map(Why::to_string).collect::<Vec<_>>().join("\n  and "))]
    Judged(Box<Verdict>),
}

impl Refusal {
    /// One word, for logs and JSON.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Signature(_) => "signature",
            Self::RolledBackBefore { .. } => "rolled_back_before",
            Self::Current => "current",
            Self::Unfit(Unfit::File(_)) => "file",
            Self::Unfit(Unfit::Network(_)) => "network",
            Self::Unfit(Unfit::NoGoldenPair | Unfit::GoldenPair(_)) => "golden_pair",
            Self::Died { .. } => "died",
            Self::Judged(_) => "judged",
        }
    }
}

/// What became of a model.
#[derive(Debug)]
pub enum Outcome {
    /// It is current, and on trial.
    Accepted {
        /// Who it is.
        signed: Signed,
        /// What was measured.
        examination: Box<Examination>,
        /// What followed from it.
        verdict: Box<Verdict>,
    },
    /// The store is as it was.
    Refused {
        /// What its file is called, which nobody has vouched for.
        name: String,
        /// BLAKE3 digest of its bytes.
        digest: String,
        /// Why.
        why: Refusal,
    },
}

impl Gate {
    /// Examines a bundle and, when it is good, makes it the current model. Every refusal is in the store's history.
    ///
    /// # Errors
    /// When the gate itself cannot work: a store that cannot be written, a process that cannot be started.
    pub fn install(
        &self,
        bundle: &Bundle,
        keys: &TrustedKeys,
        store: &mut Store,
    ) -> Result<Outcome> {
        let digest = blake3::hash(&bundle.model).to_hex().to_string();
        match self.try_install(bundle, keys, store)? {
            Ok((signed, examination, verdict)) => Ok(Outcome::Accepted {
                signed,
                examination: Box::new(examination),
                verdict: Box::new(verdict),
            }),
            Err(why) => {
                store.note(Entry::now(What::Refused, &digest, &bundle.name, why.to_string()));
                Ok(Outcome::Refused { name: bundle.name.clone(), digest, why })
            }
        }
    }

    fn try_install(
        &self,
        bundle: &Bundle,
        keys: &TrustedKeys,
        store: &mut Store,
    ) -> Result<std::result::Result<(Signed, Examination, Verdict), Refusal>> {
        let signed = match signed_model::verify(&bundle.model, &bundle.signature, keys) {
            Ok(signed) => signed,
            Err(error) => return Ok(Err(error.into())),
        };
        let state = store.state()?;
        if state.current() == Some(&signed.digest) {
            return Ok(Err(Refusal::Current));
        }
        if let Some(before) = store.history().rolled_back(&signed.digest).filter(|_| !self.again) {
            return Ok(Err(Refusal::RolledBackBefore { why: before.why.clone() }));
        }
        // What is judged against has proved itself; a damaged one is none.
        let proven = if state.trial_starts.is_some() { state.previous() } else { state.current() };
        let resident = proven
            .filter(|digest| store.read_model(digest).is_ok())
            .map(|digest| store.model_path(digest));
        let has_resident = resident.is_some();
        let examination = match self.examine(&bundle.model, resident.as_deref())? {
            Ended::Examined(examination) => examination,
            Ended::Unfit(unfit) => return Ok(Err(unfit.into())),
            Ended::Died { doing, how } => return Ok(Err(Refusal::Died { doing, how })),
        };
        let verdict = judge(&examination, has_resident, self.unproven, &self.limits);
        if !verdict.is_accepted() {
            return Ok(Err(Refusal::Judged(Box::new(verdict))));
        }
        store.install(&bundle.model, &bundle.signature, &signed.name)?;
        Ok(Ok((signed, examination, verdict)))
    }

    fn examine(&self, candidate: &[u8], resident: Option<&Path>) -> Result<Ended> {
        let recordings =
            self.recordings.iter().map(|path| absolute(path)).collect::<Result<Vec<_>>>()?;
        let config = self.config.as_deref().map(absolute).transpose()?;
        examine(&Task {
            program: &self.program,
            candidate,
            resident: resident.map(absolute).transpose()?,
            recordings: &recordings,
            config: config.as_deref(),
            frames: self.frames,
            limits: self.child,
            idle: self.idle,
        })
    }
}

fn absolute(path: &Path) -> Result<PathBuf> {
    Ok(std::path::absolute(path)?)
}
