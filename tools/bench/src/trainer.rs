//! Speed of training, beside a textbook implementation of the same step on the same threads.

use std::path::Path;

use anyhow::{Context, Result};

use crate::peers::PeerProcess;
use crate::report::{Row, Timing, Unit};

/// Samples of one training step.
const BATCH: f64 = 12.0;
const RUNS: usize = 7;
const THREADS: &str = "2";

/// Measures all rows on the CPU, and on a GPU where there is one. Without the trainer (its Python interpreter in
/// `BENCH_TRAINER`) there are none.
///
/// # Errors
/// When the trainer fails.
pub fn rows() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let gpu = Path::new("/dev/nvidia0").exists();
    for device in ["cpu", "cuda"].into_iter().take(if gpu { 2 } else { 1 }) {
        // Each trainer runs in its own process: the textbook implementation would otherwise reuse memory that the other
        // has allocated.
        let trainer = PeerProcess::start_trainer("trainer.py", &[device, THREADS])?;
        let textbook = PeerProcess::start_trainer("trainer.py", &[device, THREADS])?;
        if let (Some(mut trainer), Some(mut textbook)) = (trainer, textbook) {
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
        let (idle, parts) =
            answer.split_once(' ').context("the trainer reports no shares of time")?;
        let busy = 1.0 - idle.parse::<f64>().with_context(|| format!("`{idle}` is no share"))?;
        let samples = Row::per_second("trainer", format!("samples, {work}, {how}"), BATCH, timing);
        let peer = BATCH / textbook_step.median;
        // Only the fastest mode of this hardware has a goal.
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

/// Runs each operation once for warm-up, then in alternation, so that load on the machine affects all alike.
fn in_turn<const N: usize>(
    trainer: &mut PeerProcess,
    operations: [&str; N],
    textbook: &mut PeerProcess,
    textbook_operation: &str,
) -> Result<([Timing; N], Timing)> {
    let mut seconds = [const { Vec::new() }; N];
    let mut textbook_seconds = Vec::new();
    for run in 0..=RUNS {
        for (name, seconds) in operations.iter().zip(&mut seconds) {
            seconds.extend(Some(trainer.seconds(name)?).filter(|_| run > 0));
        }
        textbook_seconds.extend(Some(textbook.seconds(textbook_operation)?).filter(|_| run > 0));
    }
    Ok((seconds.map(Timing::of), Timing::of(textbook_seconds)))
}

/// The fastest mode of this hardware: bfloat16 if it can multiply bfloat16 matrices. AVX512-BF16 cannot: with it alone, a
/// step took a third longer than in float32.
fn best(device: &str) -> &'static str {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    if device == "cuda" || cpu.contains("amx_bf16") { "--amp" } else { "float32" }
}
