//! `firmware-host buffer`: lists, verifies, recovers, exports, erases and serves recorded segments.

mod erase;
mod list;
mod pull_log;
mod verify;

use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use segment_store::{
    Catalogue, CpuFeatures, Entry, Finding, Name, Root, State, StoreError, export, recover_file,
};

use crate::cli::{BufferArgs, BufferTask, ExportLayout};
use pull_log::PullLog;

/// Runs one of the subcommands.
///
/// # Errors
/// When the segments cannot be read or the output cannot be written.
pub fn run(args: &BufferArgs) -> Result<ExitCode> {
    match &args.task {
        BufferTask::List { dir, json } => list::run(dir, *json).map(|()| ExitCode::SUCCESS),
        BufferTask::Verify { path, robots } => verify::run(path, robots.as_deref()),
        BufferTask::Recover { path, out } => recover_all(path, out),
        BufferTask::Export { path, layout, out } => {
            export_run(path, *layout, out).map(|()| ExitCode::SUCCESS)
        }
        BufferTask::Erase { dir, yes } => erase::run(dir, *yes),
        BufferTask::Serve { dir } => serve(dir).map(|()| ExitCode::SUCCESS),
    }
}

/// Corrects the state of segments that were modified recently but that no recorder writes any more: a recorder holds a lock on
/// its segment.
fn detect_unlocked(root: &Root, entries: &mut [Entry]) {
    for entry in entries.iter_mut().filter(|entry| entry.state == State::Open) {
        let file = root.open_file(&entry.name);
        if file.is_ok_and(|file| file.try_lock_shared().is_ok()) {
            entry.state = State::Cut;
        }
    }
}

/// The segments of a directory of runs, of one run, or the one segment at `path`.
fn segments(path: &Path) -> Result<(Root, Vec<Entry>), StoreError> {
    let is_file = path.is_file();
    let dir = if is_file {
        path.parent().filter(|dir| !dir.as_os_str().is_empty()).unwrap_or(Path::new("."))
    } else {
        path
    };
    let (root, catalogue) = Catalogue::open(dir)?;
    let mut entries = catalogue.entries;
    if is_file {
        entries.retain(|entry| {
            entry.name.run().is_empty()
                && path.file_name().is_some_and(|file| file == entry.name.file())
        });
    }
    detect_unlocked(&root, &mut entries);
    if entries.is_empty() {
        let text = format!(
            "{} contains no recording_NNNN.mcap; give a directory of runs, the --out directory of one run, or one segment",
            path.display()
        );
        return Err(StoreError::Usage(text));
    }
    Ok((root, entries))
}

/// The end of a line about a segment whose last message is at `last_ns`.
fn until(last_ns: Option<u64>) -> String {
    last_ns.map_or_else(String::new, |ns| format!(", until {:.3} s", ns as f64 * 1e-9))
}

/// Writes a whole segment for every one that is cut, corrupt or without an index, under the same name below `out`.
fn recover_all(path: &Path, out: &Path) -> Result<ExitCode> {
    let (root, entries) = segments(path)?;
    let mut recovered = 0;
    let mut failed = 0;
    for entry in &entries {
        // An error in one segment does not keep the others from being recovered.
        match recover_one(&root, entry, out) {
            Ok(true) => recovered += 1,
            Ok(false) => {}
            Err(error) => {
                eprintln!("{}: {error:#}", entry.name);
                failed += 1;
            }
        }
    }
    let others = entries.len() - recovered - failed;
    println!("{recovered} recovered, {others} whole or being written, {failed} failed");
    Ok(if failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Whether the segment was damaged and has been recovered.
fn recover_one(root: &Root, entry: &Entry, out: &Path) -> Result<bool> {
    let file = root.open_file(&entry.name).context("cannot open the segment")?;
    if segment_store::verify(&file).context("cannot read the segment")?.finding == Finding::Whole {
        return Ok(false);
    }
    if entry.state == State::Open {
        println!("{}: still being written, skipped", entry.name);
        return Ok(false);
    }
    let to = out.join(entry.name.as_str());
    std::fs::create_dir_all(to.parent().unwrap_or(out))
        .with_context(|| format!("cannot create {}", out.display()))?;
    let done = recover_file(&file, &root.path().join(entry.name.as_str()), &to)?;
    let mut lost = String::new();
    if done.bad_chunks > 0 {
        lost += &format!(", {} corrupt chunks dropped", done.bad_chunks);
    }
    if done.unknown_messages > 0 {
        lost += &format!(", {} messages of unknown channels dropped", done.unknown_messages);
    }
    println!("{}: {} ticks{}{lost}", to.display(), done.ticks, until(done.last_ns));
    Ok(true)
}

fn export_run(path: &Path, layout: ExportLayout, out: &Path) -> Result<()> {
    let (root, entries) = segments(path)?;
    if let Some(other) = entries.iter().find(|entry| entry.name.run() != entries[0].name.run()) {
        let first = entries[0].name.run();
        bail!(
            "{} contains several runs ({first:?}, {:?}, ...); give the directory of one",
            path.display(),
            other.name.run()
        );
    }
    let files: Vec<PathBuf> =
        entries.iter().map(|entry| root.path().join(entry.name.as_str())).collect();
    match layout {
        ExportLayout::Mcap => {
            let done = export::mcap(&files, out)?;
            println!("{}: {} ticks, {} messages", out.display(), done.ticks, done.messages);
        }
        ExportLayout::Viewer => {
            let done = export::viewer(&files, out)?;
            println!("{}: {} ticks, {} messages", out.display(), done.ticks, done.messages);
            tell_date(done.dated);
            if done.unreadable + done.bad_chunks > 0 {
                println!(
                    "left out: {} messages that cannot be read, {} damaged chunks",
                    done.unreadable, done.bad_chunks
                );
            }
        }
        ExportLayout::Ros2 => {
            let done = export::ros2(&files, out)?;
            println!(
                "{}: {} messages, of these {} images, {} scans and {} maps; {} ticks had no pose",
                out.display(),
                done.messages,
                done.images,
                done.scans,
                done.maps,
                done.without_pose
            );
            tell_date(done.dated);
        }
        ExportLayout::Tum => {
            let done = export::tum(&files, out)?;
            println!(
                "{}: {} images, {} left out without a pose",
                out.display(),
                done.images,
                done.without_pose
            );
        }
        #[cfg(feature = "lerobot")]
        ExportLayout::Lerobot => {
            let done = export::lerobot(&files, out)?;
            println!(
                "{}: {} episodes, {} images, {} left out without odometry or a command",
                out.display(),
                done.episodes,
                done.frames,
                done.left_out
            );
        }
        #[cfg(not(feature = "lerobot"))]
        ExportLayout::Lerobot => bail!(
            "this build has no LeRobot export: `cargo install --path firmware-host --features lerobot` on the workstation has it"
        ),
    }
    Ok(())
}

/// Says where the dates of an export are from, if not from the recording.
fn tell_date(is_recorded: bool) {
    if !is_recorded {
        println!(
            "The recording has no date, like all of simulations: the run is dated as if it had begun when its first file was \
             written."
        );
    }
}

fn serve(dir: &Path) -> Result<()> {
    let root = Root::open(dir)?;
    let mut input = std::io::stdin().lock();
    // Not Rust's own stdout, which searches the data for line ends. Pieces of data are larger than this buffer and bypass it.
    let stdout =
        File::from(std::io::stdout().as_fd().try_clone_to_owned().context("stdout is closed")?);
    let mut output = BufWriter::with_capacity(64 << 10, stdout);
    let log = PullLog::of(dir);
    let mut log = |segment: &Name| log.sent(segment);
    segment_store::serve(&root, CpuFeatures::detect(), &mut log, &mut input, &mut output)
        .context("the connection broke")?;
    output.flush().context("the connection broke")
}
