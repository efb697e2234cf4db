//! Installing a model: check the signature, examine the model in a separate process, decide, store.
//!
//! In this order no untrusted file is parsed, no unexamined model controls the robot, and no
//! partial installation remains.

use std::path::{Path, PathBuf};

use anyhow::Result;
use runtime::model_gate::{Examination, GateLimits, RefusalReason, Verdict, judge};
use signed_model::{Bundle, BundleError, Signed, TrustedKeys};

use super::child::{ChildLimits, Ended, Task, examine};
use super::examine::Unfit;
use super::history::{Entry, What};
use super::store::Store;

/// The settings of an installation.
#[derive(Debug, Clone)]
pub struct Gate {
    /// Path of this program, which is started again for the examination.
    pub program: PathBuf,
    pub config: Option<PathBuf>,
    /// Runs, or folders with runs, from which held-out frames are taken.
    pub recordings: Vec<PathBuf>,
    /// Maximum number of held-out frames.
    pub frames: usize,
    /// Resource limits of the examination.
    pub child: ChildLimits,
    /// Limits within which a model is accepted.
    pub limits: GateLimits,
    /// Whether a first model is accepted without enough held-out frames.
    pub unproven: bool,
    /// Whether a model that was rolled back may be examined again.
    pub again: bool,
    /// Whether the examination runs at idle priority.
    pub idle: bool,
}

/// Why a model was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The bundle is malformed, not signed, or not signed by a trusted key.
    #[error(transparent)]
    Signature(#[from] BundleError),
    /// The model was rolled back before.
    #[error(
        "the model was rolled back before ({why}); train another one, or try this one again with --again"
    )]
    RolledBackBefore {
        /// The reason of that rollback.
        why: String,
    },
    /// The model is the current one already.
    #[error("the model is the current one already")]
    Current,
    /// The model cannot be used on this robot.
    #[error(transparent)]
    Unfit(#[from] Unfit),
    /// The examining process ended without a result.
    #[error(
        "the process that examined the model failed while {doing}: {how}; the model must need less memory and time"
    )]
    Died {
        /// The step during which it ended.
        doing: String,
        /// Exit status, signal or time-out.
        how: String,
    },
    /// The model is worse, too slow, or not shown to be as good as the resident model.
    #[error("{}", .0.refused.iter().map(RefusalReason::to_string).collect::<Vec<_>>().join("\n  and "))]
    Judged(Box<Verdict>),
}

impl Refusal {
    /// Whether the model was compared with the resident one.
    #[must_use]
    pub fn was_compared(&self) -> bool {
        matches!(self, Self::Judged(verdict) if !verdict.compared.is_empty())
    }

    /// The kind of refusal as a word, for logs and JSON.
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

/// Result of an installation.
#[derive(Debug)]
pub enum Outcome {
    /// The model is the current one now, on trial.
    Accepted { signed: Signed, examination: Box<Examination>, verdict: Box<Verdict> },
    /// The model was refused; the installed models are unchanged.
    Refused {
        /// File name of the bundle. It is not covered by a signature.
        name: String,
        /// BLAKE3 digest of the model, hexadecimal.
        digest: String,
        why: Refusal,
    },
}

impl Gate {
    /// Examines a bundle and, if it passes, makes it the current model. A refusal is added to the
    /// store's history.
    ///
    /// # Errors
    /// If the store cannot be read or written, or the examining process cannot be started.
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
                let entry = Entry::now(What::Refused, &digest, &bundle.name, why.to_string());
                store.note(Entry { was_compared: why.was_compared(), ..entry });
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
        // The candidate is compared with a model that has passed its trial. A damaged model is
        // ignored.
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
        let limits = GateLimits { tries: store.history().tries().saturating_add(1), ..self.limits };
        let verdict = judge(&examination, has_resident, self.unproven, &limits);
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
