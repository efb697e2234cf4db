//! How fast the trainer learns, beside a textbook implementation of the same step on the same threads.

use std::path::Path;

use anyhow::{Context, Result};

use crate::peers::PeerProcess;
use crate::report::{Row, Timing, Unit};

/// Frames of one step.
const BATCH: f64 = 12.0;
const RUNS: usize = 7;
const THREADS: &str = "2";

/// Measures the room on the CPU, and on a GPU where there is one. Without the trainer (`BENCH_TRAINER` names its Python) it
/// has no rows.
///
/// # Errors
/// When the trainer fails.
pub fn rows() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let gpu = Path::new("/dev/nvidia0").exists();
    for device in ["cpu", "cuda"].into_iter().take(if gpu { 2 } else { 1 }) {
        // Each in a process of its own: from the trainer's first step on its memory is kept, and the textbook would profit.
        let start = || PeerProcess::start_trainer("trainer.py", &[device, THREADS]);
        if let (Some(mut trainer), Some(mut textbook)) = (start()?, start()?) {
            rows.extend(on(device, &mut trainer, &mut textbook)?);
        }
    }
    Ok(rows)
}

fn on(device: &str, trainer: &mut PeerProcess, textbook: &mut PeerProcess) -> Result<Vec<Row>> {
    let ([step, amp], textbook_step) =
        in_turn(trainer, ["step", "step_amp"], textbook, "textbook_step")?;
    let ([loss], textbook_loss) = in_turn(trainer, ["loss"], textbook, "textbook_loss")?;
    let work = format!("Monodepth2-R18 96x320, batch 12, {device}");
    let mut rows = Vec::new();
    for (how, timing, shares) in [("float32", step, "shares"), ("--amp", amp, "shares_amp")] {
        let answer = trainer.ask(shares)?;
        let (idle, parts) = answer.split_once(' ').context("a trainer without shares")?;
        let busy = 1.0 - idle.parse::<f64>().with_context(|| format!("`{idle}` is no share"))?;
        let samples = Row::per_second("trainer", format!("samples, {work}, {how}"), BATCH, timing);
        let peer = BATCH / textbook_step.median;
        // The fastest way that the processor has is the one that must be fast.
        let samples = samples.peer("textbook PyTorch", peer).note(parts.trim_end_matches(','));
        rows.push(if how == best(device) { samples.goal(1.5 * peer, 2.5 * peer) } else { samples });
        let busy = Timing { min: busy, median: busy, max: busy };
        rows.push(
            Row::new(
                "trainer",
                format!("share of time not waiting for data, {device}, {how}"),
                Unit::Share,
                busy,
            )
            .goal(0.95, 0.99),
        );
    }
    let peer = textbook_loss.median;
    rows.push(
        Row::seconds(
            "trainer",
            format!("warp, SSIM, minimum and smoothness with gradient, {work}"),
            loss,
        )
        .peer("textbook PyTorch", peer)
        .goal(peer / 2.0, peer / 3.0),
    );
    Ok(rows)
}

/// Each piece of work once without counting, then by turns, so that a busy machine slows all down alike.
fn in_turn<const N: usize>(
    trainer: &mut PeerProcess,
    work: [&str; N],
    textbook: &mut PeerProcess,
    textbook_work: &str,
) -> Result<([Timing; N], Timing)> {
    let mut seconds = [const { Vec::new() }; N];
    let mut textbook_seconds = Vec::new();
    for run in 0..=RUNS {
        for (name, seconds) in work.iter().zip(&mut seconds) {
            seconds.extend(Some(trainer.seconds(name)?).filter(|_| run > 0));
        }
        textbook_seconds.extend(Some(textbook.seconds(textbook_work)?).filter(|_| run > 0));
    }
    Ok((seconds.map(Timing::of), Timing::of(textbook_seconds)))
}

/// What a user of this machine would choose: bfloat16 where the hardware multiplies matrices of it. AVX512-BF16 does not: with it alone,
/// a step took a third longer than in float32.
fn best(device: &str) -> &'static str {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    if device == "cuda" || cpu.contains("amx_bf16") { "--amp" } else { "float32" }
}
