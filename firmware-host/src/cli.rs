//! The command line.

use std::path::PathBuf;

use clap::{ArgGroup, Args, Parser, Subcommand, ValueEnum};
use runtime::exploration::PolicyKind;
use runtime::robot::DepthSource;

use crate::faults::FaultArgs;
use crate::model::ModelArgs;
use crate::replay::Moment;

/// A robot that explores a home, and learns how far things are.
#[derive(Debug, Parser)]
#[command(name = "firmware-host", version, propagate_version = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Explore a simulated home, in virtual time.
    Explore(ExploreArgs),
    /// Depth, and its accuracy, on a recorded sequence (TUM RGB-D layout with a dataset.toml) or a recorded run.
    Perceive(PerceiveArgs),
    /// Recompute every decision of a recorded run; exit 0 only when all are the same.
    Replay(ReplayArgs),
    /// Cut the seconds around a stop or fault out of a run: one small file for a bug report, which `replay` recomputes.
    Reproduce(ReproduceArgs),
    /// Test views of a scene: pictures with true depth from all over its free floor, each with what was seen before it.
    Views(ViewsArgs),
    /// Drive a real robot: camera, LiDAR and base as the configuration says.
    Run(RunArgs),
    /// One screen: how the running robot is. Exits with 1 when something is wrong.
    Health(HealthArgs),
    /// How much later the camera stamps its pictures than it takes them, from a recorded run; what to configure.
    CameraLatency(CameraLatencyArgs),
    /// Signed models: install, list, verify, go back.
    Model(ModelArgs),
    /// Check a configuration file and print what is in effect; with --devices, check what is connected.
    Check(CheckArgs),
    /// What was recorded: list, verify, make cut segments whole, write in other layouts, serve to pull-buffer.
    Buffer(BufferArgs),
}

/// Arguments of `explore`.
#[derive(Debug, Args)]
pub struct ExploreArgs {
    /// `builtin:apartment?seed=1` (also `house`, `office`), or a .glb, .gltf or .obj file.
    #[arg(long)]
    pub scene: String,
    /// How goals are chosen.
    #[arg(long, value_enum, default_value_t = PolicyArg::Active)]
    pub policy: PolicyArg,
    /// A depth network (ONNX). Without one, coarse depth is the depth.
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Folder of signed models: the current one drives, and another one that is installed meanwhile takes over, on trial. --model
    /// is its first one, if it never had any.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["dir", "depth"])]
    pub model_store: Option<PathBuf>,
    /// Which depth goes into the map [default: network with --model, else coarse].
    #[arg(long, value_enum)]
    pub depth: Option<DepthArg>,
    /// Camera frames to explore for; one step each.
    #[arg(long, default_value_t = 3000, allow_negative_numbers = true, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    pub frames: u64,
    /// Seed of everything random: start pose, policy, noise.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder for summary, pictures and recording. Made if missing; must be empty of other runs.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Configuration file; see `check`.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Start pose in the scene: x,y in metres and heading in degrees [default: found by itself].
    #[arg(long, value_name = "X,Y,DEG", allow_hyphen_values = true, value_parser = parse_start)]
    pub start: Option<[f64; 3]>,
    /// The scene file's axes and units.
    #[command(flatten)]
    pub scene_file: SceneFileArgs,
    /// Do not record. The run cannot be replayed.
    #[arg(long)]
    pub no_recording: bool,
    /// Also write every picture's coarse depth into this folder, for training. Made if missing.
    #[arg(long, value_name = "DIR")]
    pub dump: Option<PathBuf>,
    /// What is broken on purpose.
    #[command(flatten)]
    pub faults: FaultArgs,
    /// Whether better networks come while the robot explores.
    #[command(flatten)]
    pub hand_over: HandOverArgs,
    /// Where a live picture of the run goes.
    #[command(flatten)]
    pub rerun: RerunArgs,
}

/// A scene file's axes and units.
#[derive(Debug, Args, Clone, Copy)]
pub struct SceneFileArgs {
    /// The scene file's vertical axis [default: by its format].
    #[arg(long, value_enum)]
    pub scene_up: Option<UpArg>,
    /// Metres per unit of the scene file.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true, value_parser = parse_scale)]
    pub scene_scale: f64,
}

/// Whether better networks come while the robot explores.
#[derive(Debug, Args, Default)]
pub struct HandOverArgs {
    /// Wait for better networks: before turn --first and every --every turns after it, write round_NNNN.json into this
    /// folder and go on when model_NNNN.onnx is there.
    #[arg(long = "hand-over", value_name = "DIR", requires_all = ["first", "every"], conflicts_with_all = ["model", "no_recording"])]
    pub dir: Option<PathBuf>,
    /// Frames before the first network.
    #[arg(long, requires = "dir", value_parser = clap::value_parser!(u64).range(1..))]
    pub first: Option<u64>,
    /// Frames from one network to the next.
    #[arg(long, requires = "dir", value_parser = clap::value_parser!(u64).range(1..))]
    pub every: Option<u64>,
}

/// Where a live picture of the run goes.
#[derive(Debug, Args, Default)]
pub struct RerunArgs {
    /// Also write run.rrd for the Rerun viewer.
    #[cfg(feature = "rerun")]
    #[arg(long)]
    pub rerun: bool,
    /// Also stream to a running Rerun viewer, as rerun+http://127.0.0.1:9876/proxy.
    #[cfg(feature = "rerun")]
    #[arg(long, value_name = "URL")]
    pub rerun_connect: Option<String>,
}

#[cfg(feature = "rerun")]
impl RerunArgs {
    /// Files and viewers that were asked for; `None`: none.
    #[must_use]
    pub fn targets(&self, out: &std::path::Path) -> Option<crate::rerun_stream::RerunTargets> {
        let file = self.rerun.then(|| out.join(crate::rerun_stream::RERUN_FILE));
        let viewer = self.rerun_connect.clone();
        (file.is_some() || viewer.is_some())
            .then_some(crate::rerun_stream::RerunTargets { file, viewer })
    }
}

/// Arguments of `run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Configuration file; see `check`.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Folder for the recording and the summary. Made if missing; must be empty of other runs [default: DATE-TIME in
    /// `models.recordings`, else in the current folder].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// How goals are chosen.
    #[arg(long, value_enum, default_value_t = PolicyArg::Active)]
    pub policy: PolicyArg,
    /// A depth network (ONNX). Without one, coarse depth is the depth.
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Folder of signed models: the current one drives, and another one that is installed meanwhile takes over, on trial. --model
    /// is its first one, if it never had any [default: `models.store`].
    #[arg(long, value_name = "DIR")]
    pub model_store: Option<PathBuf>,
    /// Ends after this many pictures [default: goes on until it is told to stop].
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: Option<u64>,
    /// Seed of everything random that the robot decides.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// File that `health` reads [default: `run.status_file`].
    #[arg(long, value_name = "FILE")]
    pub status: Option<PathBuf>,
    /// Do not record. The run cannot be replayed.
    #[arg(long)]
    pub no_recording: bool,
    /// What is broken on purpose.
    #[command(flatten)]
    pub faults: FaultArgs,
}

/// Arguments of `health`.
#[derive(Debug, Args)]
pub struct HealthArgs {
    /// The running robot's status file.
    #[arg(long, value_name = "FILE", default_value = "/run/embodied-depth/status.json")]
    pub status: PathBuf,
    /// The status as it is in the file.
    #[arg(long)]
    pub json: bool,
    /// Look again every half second until interrupted.
    #[arg(long, conflicts_with = "json")]
    pub watch: bool,
}

/// Arguments of `perceive`.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("seen").args(["dataset", "recording"]).required(true)))]
pub struct PerceiveArgs {
    /// Folder with rgb.txt, groundtruth.txt, dataset.toml and perhaps depth.txt.
    #[arg(long, value_name = "DIR")]
    pub dataset: Option<PathBuf>,
    /// Instead: the --out folder of a run, or one .mcap file. Its own configuration counts, unless --config is given.
    #[arg(long, value_name = "RUN")]
    pub recording: Option<PathBuf>,
    /// A depth network (ONNX).
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Folder for summary and pictures.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Also write every picture's coarse depth into this folder, for training. Made if missing.
    #[arg(long, value_name = "DIR")]
    pub dump: Option<PathBuf>,
    /// Configuration file; see `check`.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// Arguments of `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// The --out folder of a run, or one .mcap file.
    pub run: PathBuf,
    /// Begin at the last segment that begins not after this turn (1200) or time since the first turn (61.5s).
    #[arg(long, value_name = "TURN|SECONDS", allow_negative_numbers = true)]
    pub from: Option<Moment>,
    /// End at the first turn that decides differently.
    #[arg(long)]
    pub until_mismatch: bool,
    /// The models of the run.
    #[command(flatten)]
    pub models: RunModels,
}

/// The models of a recorded run, which are not in its recording.
#[derive(Debug, Args)]
pub struct RunModels {
    /// The depth network that the run was made with, if it was.
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// The folder from which the run was handed its networks, if it was.
    #[arg(long, value_name = "DIR")]
    pub hand_over: Option<PathBuf>,
    /// The folder of signed models that the run drove with, if it did.
    #[arg(long, value_name = "DIR", conflicts_with = "model")]
    pub model_store: Option<PathBuf>,
}

/// Arguments of `reproduce`.
#[derive(Debug, Args)]
pub struct ReproduceArgs {
    /// The --out folder of a run, or one .mcap file.
    pub run: PathBuf,
    /// The turn (1200) or the time since the first turn (61.5s) that it is about [default: the last stop or fault].
    #[arg(long, value_name = "TURN|SECONDS")]
    pub at: Option<Moment>,
    /// Seconds before that.
    #[arg(long, default_value_t = 3.0, allow_negative_numbers = true, value_parser = parse_seconds)]
    pub before: f64,
    /// Seconds after that.
    #[arg(long, default_value_t = 2.0, allow_negative_numbers = true, value_parser = parse_seconds)]
    pub after: f64,
    /// The file to write, as bug.mcap. Must not be there yet.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// The models of the run.
    #[command(flatten)]
    pub models: RunModels,
}

/// Arguments of `views`.
#[derive(Debug, Args)]
pub struct ViewsArgs {
    /// As for `explore`.
    #[arg(long)]
    pub scene: String,
    /// How many views.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub count: u64,
    /// Seed of their poses.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder for the views, in the form of `perceive --dataset --dump`. Made if missing.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Configuration file; see `check`.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// The scene file's axes and units.
    #[command(flatten)]
    pub scene_file: SceneFileArgs,
}

/// Arguments of `check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Configuration file; without one, the documented defaults are printed.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Instead of printing what is in effect, open each device for some seconds and say how it is. Nothing is armed and nothing
    /// moves. Exits with 1 unless all are well.
    #[arg(long, requires = "config")]
    pub devices: bool,
}

/// Arguments of `camera-latency`.
#[derive(Debug, Args)]
pub struct CameraLatencyArgs {
    /// The --out folder of a run, or one .mcap file. A minute in which it turned to and fro is enough.
    pub run: PathBuf,
}

/// Arguments of `buffer`.
#[derive(Debug, Args)]
pub struct BufferArgs {
    #[command(subcommand)]
    pub task: BufferTask,
}

/// Subcommands of `buffer`.
#[derive(Debug, Subcommand)]
pub enum BufferTask {
    /// List all segments with their sizes, times, ticks, states and markers. Reads only the ends of the files.
    List {
        /// A directory of runs, or the --out directory of one run.
        dir: PathBuf,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Check all checksums and report which segments are whole, cut or corrupt. Exits with 1 unless all are whole.
    Verify {
        /// A directory of runs, the --out directory of one run, or one segment.
        path: PathBuf,
    },
    /// Write a repaired copy of every segment that is cut or corrupt, with all messages of its intact chunks.
    Recover {
        /// A directory of runs, the --out directory of one run, or one segment.
        path: PathBuf,
        /// The directory for the repaired copies, which have the names of the originals.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Export one run in another format.
    Export {
        /// The --out directory of a run, or one segment.
        path: PathBuf,
        /// The format to export.
        #[arg(long = "as", value_enum, value_name = "FORMAT")]
        layout: ExportLayout,
        /// The file (mcap) or directory (other formats) to create. It must not exist.
        #[arg(long, value_name = "PATH")]
        out: PathBuf,
    },
    /// Answer the requests of pull-buffer, which runs this command over ssh, on standard input and output. Writes only markers
    /// for the segments that were pulled.
    Serve {
        /// A directory of runs, or the --out directory of one run.
        dir: PathBuf,
    },
}

/// The values of `buffer export --as`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportLayout {
    /// One MCAP file with an index.
    Mcap,
    /// A ROS 2 bag with images, calibration, scans, odometry and transforms.
    Ros2,
    /// The format of the TUM RGB-D benchmark with poses from odometry, which `perceive --dataset` reads.
    Tum,
    /// A LeRobot dataset, format 3.0: images, odometry and sent commands in Parquet files.
    #[cfg(feature = "lerobot")]
    Lerobot,
}

/// Policies by their names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PolicyArg {
    /// Forward, left or right at random, every frame anew.
    Random,
    /// Random arcs of 16 steps.
    Heuristic,
    /// Straight on, a little to the right after a collision.
    Forward,
    /// To where free floor meets the unknown.
    Frontier,
    /// To where two looks at one place disagree.
    Inconsistency,
    /// Frontier and inconsistency by turns.
    Active,
}

impl From<PolicyArg> for PolicyKind {
    fn from(policy: PolicyArg) -> Self {
        match policy {
            PolicyArg::Random => Self::Random,
            PolicyArg::Heuristic => Self::Heuristic,
            PolicyArg::Forward => Self::Forward,
            PolicyArg::Frontier => Self::Frontier,
            PolicyArg::Inconsistency => Self::Inconsistency,
            PolicyArg::Active => Self::Active,
        }
    }
}

/// Depth sources by their names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DepthArg {
    /// From ego-motion.
    Coarse,
    /// From the network.
    Network,
    /// Ground truth; tests what comes after depth, and says nothing about the robot.
    Truth,
}

impl From<DepthArg> for DepthSource {
    fn from(depth: DepthArg) -> Self {
        match depth {
            DepthArg::Coarse => Self::Coarse,
            DepthArg::Network => Self::Network,
            DepthArg::Truth => Self::Truth,
        }
    }
}

/// Vertical axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum UpArg {
    /// As glTF has it.
    Y,
    /// As most scans have it.
    Z,
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| (0.0..=3600.0).contains(seconds));
    seconds.ok_or_else(|| format!("`{text}` is not a number of seconds from 0 to 3600"))
}

fn parse_scale(text: &str) -> Result<f64, String> {
    let scale = text.parse::<f64>().ok().filter(|scale| *scale > 0.0 && scale.is_finite());
    scale.ok_or_else(|| format!("`{text}` is not a number above 0"))
}

fn parse_start(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> =
        text.split(',').map(|part| part.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok([x, y, yaw]) if [x, y, yaw].iter().all(|value| value.is_finite()) => Ok([*x, *y, *yaw]),
        _ => Err(format!("`{text}` is not three numbers such as 1.5,-2,90")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }

    #[test]
    fn a_number_below_zero_is_refused_by_its_own_name_and_not_taken_for_an_option() {
        for line in
            ["explore --scene s --out o --frames -1", "explore --scene s --out o --scene-scale -2"]
        {
            let error = Cli::try_parse_from(["firmware-host"].into_iter().chain(line.split(' ')))
                .unwrap_err()
                .to_string();
            assert!(error.contains("invalid value '-"), "{error}");
        }
        assert!(
            parse_scale("nan").is_err() && parse_scale("0").is_err() && parse_scale("inf").is_err()
        );
        assert_eq!(parse_scale("0.01"), Ok(0.01));
    }

    #[test]
    fn perceive_names_both_kinds_of_pictures_when_neither_is_given() {
        let error = Cli::try_parse_from(["firmware-host", "perceive", "--out", "o"])
            .unwrap_err()
            .to_string();
        assert!(error.contains("--dataset") && error.contains("--recording"), "{error}");
    }

    #[test]
    fn a_start_pose_is_three_finite_numbers() {
        assert_eq!(parse_start("1, -2.5,90"), Ok([1.0, -2.5, 90.0]));
        assert!(parse_start("1,2").is_err());
        assert!(parse_start("1,2,nan").is_err());
    }
}
