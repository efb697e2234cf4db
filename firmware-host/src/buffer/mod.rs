//! `firmware-host buffer`: lists, verifies, recovers, exports, erases and serves recorded segments.

mod damage;
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
    Catalogue, CpuFeatures, Entry, Finding, Root, State, StoreError, export, is_segment_name,
    recover_file,
};

use crate::cli::{BufferArgs, BufferTask, ExportLayout};
use crate::failure::sentence;
use damage::Damage;
use pull_log::PullLog;

/// Runs one of the subcommands.
///
/// # Errors
/// When the segments cannot be read or the output cannot be written.
pub fn run(args: &BufferArgs) -> Result<ExitCode> {
    match &args.task {
        BufferTask::List { dir, json } => list::run(dir, *json),
        BufferTask::Verify { path, robots } => verify::run(path, robots.as_deref()),
        BufferTask::Recover { path, out } => recover_all(path, out),
        BufferTask::Export { path, layout, out } => export_run(path, *layout, out),
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

/// The segments of a directory of runs, of one run, or the one segment at `path`, and what cannot be read of them.
fn find(path: &Path) -> Result<(Root, Catalogue), StoreError> {
    let is_file = path.is_file();
    let dir = if is_file {
        path.parent().filter(|dir| !dir.as_os_str().is_empty()).unwrap_or(Path::new("."))
    } else {
        path
    };
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    if is_file && !is_segment_name(&file) {
        let text = format!(
            "{} is not named like a segment; rename it to recording_0000.mcap",
            path.display()
        );
        return Err(StoreError::Usage(text));
    }
    let (root, mut catalogue) = Catalogue::open(dir)?;
    if is_file {
        catalogue.entries.retain(|entry| entry.name.as_str() == file);
        catalogue
            .unread
            .retain(|unread| unread.name.as_ref().is_some_and(|name| name.as_str() == file));
    }
    detect_unlocked(&root, &mut catalogue.entries);
    Ok((root, catalogue))
}

/// As [`find`]; an error without any segment that can be read.
fn segments(path: &Path) -> Result<(Root, Catalogue), StoreError> {
    let (root, catalogue) = find(path)?;
    match (catalogue.entries.first(), catalogue.unread.first()) {
        (None, Some(unread)) => Err(StoreError::Usage(unread.to_string())),
        (None, None) => Err(StoreError::Usage(format!(
            "{} contains no recording_NNNN.mcap; give a directory of runs, the --out directory of one run, or one segment",
            path.display()
        ))),
        (Some(_), _) => Ok((root, catalogue)),
    }
}

/// Names what cannot be read. Returns whether there is nothing of that.
fn tell_unread(catalogue: &Catalogue) -> bool {
    for unread in &catalogue.unread {
        eprintln!("{unread}");
    }
    catalogue.unread.is_empty()
}

/// Names the segments that are missing between others. That is no failure: a robot deletes segments for space.
fn tell_missing(catalogue: &Catalogue) {
    for gap in catalogue.gaps() {
        println!("missing: {gap}; deleted (the robot does so for space), or not copied");
    }
}

/// 0, or 1 for a command that left something out.
fn exit_code(is_complete: bool) -> ExitCode {
    if is_complete { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// The end of a line about a segment whose last message is at `last_ns`.
fn until(last_ns: Option<u64>) -> String {
    last_ns.map_or_else(String::new, |ns| format!(", until {:.3} s", ns as f64 * 1e-9))
}

/// Writes a whole segment for every one that is cut, corrupt or without an index, under the same name below `out`.
fn recover_all(path: &Path, out: &Path) -> Result<ExitCode> {
    let (root, catalogue) = segments(path)?;
    tell_unread(&catalogue);
    let mut recovered = 0;
    let mut others = 0;
    let mut failed = catalogue.unread.len();
    for entry in &catalogue.entries {
        // An error in one segment does not keep the others from being recovered.
        match recover_one(&root, entry, out) {
            Ok(true) => recovered += 1,
            Ok(false) => others += 1,
            Err(error) => {
                eprintln!("{}", sentence(&error));
                failed += 1;
            }
        }
    }
    println!("{recovered} recovered, {others} whole or being written, {failed} failed");
    Ok(exit_code(failed == 0))
}

/// Whether the segment was damaged and has been recovered.
fn recover_one(root: &Root, entry: &Entry, out: &Path) -> Result<bool> {
    let path = root.path().join(entry.name.as_str());
    let file = root.open_file(&entry.name).with_context(|| cannot_read(&path))?;
    let verified = segment_store::verify(&file).with_context(|| cannot_read(&path))?;
    if verified.finding == Finding::Whole {
        return Ok(false);
    }
    if entry.state == State::Open {
        println!("{}: still being written, skipped", entry.name);
        return Ok(false);
    }
    let to = out.join(entry.name.as_str());
    std::fs::create_dir_all(to.parent().unwrap_or(out))
        .with_context(|| format!("cannot create {}", out.display()))?;
    let done = recover_file(&file, &path, &to)?;
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

fn cannot_read(path: &Path) -> String {
    format!("cannot read {}", path.display())
}

/// Exports what can be read of a run. The exit code is 1 if that is not all.
fn export_run(path: &Path, layout: ExportLayout, out: &Path) -> Result<ExitCode> {
    let (root, catalogue) = segments(path)?;
    let mut runs = catalogue.runs().into_keys();
    if let (Some(first), Some(other)) = (runs.next(), runs.next()) {
        bail!(
            "{} contains several runs ({first:?}, {other:?}, ...); give the directory of one",
            path.display()
        );
    }
    let files: Vec<PathBuf> =
        catalogue.entries.iter().map(|entry| root.path().join(entry.name.as_str())).collect();
    let damage = export_as(layout, &files, out)?;
    let is_all_read = tell_unread(&catalogue);
    let left_out = damage.left_out(&catalogue);
    if !left_out.is_empty() {
        println!("left out: {}", left_out.join(", "));
    }
    tell_missing(&catalogue);
    Ok(exit_code(is_all_read && left_out.is_empty()))
}

/// Exports segments, prints what was written, and returns what was not.
fn export_as(layout: ExportLayout, files: &[PathBuf], out: &Path) -> Result<Damage> {
    match layout {
        ExportLayout::Mcap => {
            let done = export::mcap(files, out)?;
            println!("{}: {} ticks, {} messages", out.display(), done.ticks, done.messages);
            Ok(Damage { chunks: done.bad_chunks, messages: done.unknown_messages, cut: done.cut })
        }
        ExportLayout::Viewer => {
            let done = export::viewer(files, out)?;
            println!("{}: {} ticks, {} messages", out.display(), done.ticks, done.messages);
            tell_date(done.dated);
            Ok(Damage { chunks: done.bad_chunks, messages: done.unreadable, cut: done.cut })
        }
        ExportLayout::Tum => {
            let done = export::tum(files, out)?;
            println!(
                "{}: {} images, {} left out without a pose",
                out.display(),
                done.images,
                done.without_pose
            );
            Ok(Damage::cut(done.cut))
        }
        ExportLayout::Ros2 => bail!(of_trainer("ros2")),
        ExportLayout::Lerobot => bail!(of_trainer("lerobot")),
    }
}

/// Names the command that writes a format whose libraries are Python's.
fn of_trainer(format: &str) -> String {
    format!(
        "the trainer writes this format on the workstation: `embodied-depth convert RUN --as {format} --out DIR` \
         (`pip install -e \"tools/trainer[exports]\"` in the checkout)"
    )
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
    let features = CpuFeatures::detect();
    segment_store::serve(&root, features, &mut |name| log.sent(name), &mut input, &mut output)
        .context("the connection broke")?;
    output.flush().context("the connection broke")
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::symlink;

    use runtime::recording::Views;

    use super::*;
    use crate::record::tests::{run_header, some_tick};
    use crate::record::{Recorder, RecorderOptions};

    /// A run of four segments, of two ticks in each but the last.
    fn run_of_four(dir: &Path) -> PathBuf {
        let run = dir.join("monday");
        let options =
            RecorderOptions { segment_ns: 150_000_000, ..RecorderOptions::simulation(&run) };
        let mut recorder = Recorder::start(options, run_header()).unwrap();
        for tick in 0..7 {
            recorder.record(some_tick(tick), Views::default()).unwrap();
        }
        recorder.finish().unwrap();
        assert_eq!(segments(&run).unwrap().1.entries.len(), 4);
        run
    }

    fn path_of(run: &Path, number: u32) -> PathBuf {
        run.join(format!("recording_{number:04}.mcap"))
    }

    /// Cuts a segment in its header.
    fn cut(segment: &Path) {
        let bytes = fs::read(segment).unwrap();
        fs::write(segment, &bytes[..200]).unwrap();
    }

    fn exported(run: &Path, layout: ExportLayout, to: &str) -> Result<ExitCode> {
        export_run(run, layout, &run.with_file_name(to))
    }

    const ALL: [(ExportLayout, &str); 3] = [
        (ExportLayout::Mcap, "mcap"),
        (ExportLayout::Viewer, "viewer"),
        (ExportLayout::Tum, "tum"),
    ];

    #[test]
    fn a_segment_that_cannot_be_read_makes_every_command_fail_and_the_others_are_handled() {
        let dir = tempfile::tempdir().unwrap();
        let run = run_of_four(dir.path());
        let moved = dir.path().join("elsewhere.mcap");
        fs::rename(path_of(&run, 1), &moved).unwrap();
        symlink(&moved, path_of(&run, 1)).unwrap();
        let (_, catalogue) = segments(&run).unwrap();
        let told = catalogue.unread[0].to_string();
        assert!(told.contains("recording_0001.mcap: it is a symbolic link"), "{told}");
        assert_eq!(catalogue.entries.len(), 3);
        assert_eq!(list::run(&run, true).unwrap(), ExitCode::FAILURE);
        assert_eq!(list::run(&run, false).unwrap(), ExitCode::FAILURE);
        assert_eq!(verify::run(&run, None).unwrap(), ExitCode::FAILURE);
        let out = dir.path().join("whole");
        assert_eq!(recover_all(&run, &out).unwrap(), ExitCode::FAILURE);
        for (layout, to) in ALL {
            assert_eq!(exported(&run, layout, to).unwrap(), ExitCode::FAILURE, "{to}");
            assert!(dir.path().join(to).exists(), "{to}");
        }
        let alone = segments(&path_of(&run, 1)).unwrap_err().to_string();
        assert_eq!(alone, told);
    }

    #[test]
    fn formats_that_the_trainer_writes_are_refused_with_its_command() {
        let dir = tempfile::tempdir().unwrap();
        let run = run_of_four(dir.path());
        for (layout, name) in [(ExportLayout::Ros2, "ros2"), (ExportLayout::Lerobot, "lerobot")] {
            let said = exported(&run, layout, "out").unwrap_err().to_string();
            let command = format!("`embodied-depth convert RUN --as {name} --out DIR`");
            assert!(said.contains(&command), "{said}");
            assert!(!dir.path().join("out").exists());
        }
    }

    #[test]
    fn a_whole_run_is_verified_listed_and_exported_without_complaint() {
        let dir = tempfile::tempdir().unwrap();
        let run = run_of_four(dir.path());
        assert_eq!(list::run(&run, false).unwrap(), ExitCode::SUCCESS);
        assert_eq!(list::run(&path_of(&run, 2), false).unwrap(), ExitCode::SUCCESS);
        assert_eq!(verify::run(&run, None).unwrap(), ExitCode::SUCCESS);
        assert_eq!(verify::run(&path_of(&run, 2), None).unwrap(), ExitCode::SUCCESS);
        for (layout, to) in ALL {
            assert_eq!(exported(&run, layout, to).unwrap(), ExitCode::SUCCESS, "{to}");
        }
    }

    #[test]
    fn an_export_of_a_cut_run_writes_what_can_be_read_and_fails() {
        let dir = tempfile::tempdir().unwrap();
        let run = run_of_four(dir.path());
        cut(&path_of(&run, 1));
        for (layout, to) in ALL {
            assert_eq!(exported(&run, layout, to).unwrap(), ExitCode::FAILURE, "{to}");
            assert!(dir.path().join(to).exists(), "{to}");
        }
    }

    #[test]
    fn a_run_from_which_the_robot_deleted_segments_for_space_is_whole_and_is_exported() {
        let dir = tempfile::tempdir().unwrap();
        let run = run_of_four(dir.path());
        for number in [1, 0] {
            fs::remove_file(path_of(&run, number)).unwrap();
            assert_eq!(verify::run(&run, None).unwrap(), ExitCode::SUCCESS, "{number}");
            let to = format!("without-{number}.mcap");
            assert_eq!(exported(&run, ExportLayout::Mcap, &to).unwrap(), ExitCode::SUCCESS);
        }
    }

    #[test]
    fn recovering_an_empty_segment_fails_and_writes_no_file() {
        let dir = tempfile::tempdir().unwrap();
        let run = run_of_four(dir.path());
        fs::write(path_of(&run, 3), "").unwrap();
        let out = dir.path().join("whole");
        let (root, catalogue) = segments(&run).unwrap();
        let empty = catalogue.entries.last().unwrap();
        let error = sentence(&recover_one(&root, empty, &out).unwrap_err());
        assert!(error.contains("recording_0003.mcap") && error.contains("(0 bytes)"), "{error}");
        assert_eq!(fs::read_dir(&out).unwrap().count(), 0);
        assert_eq!(recover_all(&run, &out).unwrap(), ExitCode::FAILURE);
    }

    #[test]
    fn a_recording_with_another_name_is_told_to_be_renamed() {
        let dir = tempfile::tempdir().unwrap();
        let run = run_of_four(dir.path());
        let bug = dir.path().join("bug.mcap");
        fs::copy(path_of(&run, 0), &bug).unwrap();
        for error in [
            exported(&bug, ExportLayout::Viewer, "v.mcap").unwrap_err(),
            list::run(&bug, false).unwrap_err(),
        ] {
            let said = error.to_string();
            assert!(said.contains("bug.mcap is not named like a segment; rename it"), "{said}");
        }
    }
}
