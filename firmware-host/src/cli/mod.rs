//! The command line.

pub mod values;

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{ArgGroup, Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use runtime::exploration::PolicyKind;
use runtime::robot::DepthSource;

use crate::areas::AreaArgs;
use crate::config::Odometry;
use crate::faults::FaultArgs;
use crate::model::ModelArgs;
use crate::replay::Moment;
use values::{parse_place, parse_scale, parse_seconds, parse_start, whole_number};

/// The end of the help.
const ENVIRONMENT: &str = "\
Environment:
  RUST_LOG         What is logged to standard error, such as RUST_LOG=info or RUST_LOG=warn,firmware_host::model=debug.
                   Default: warnings, and during `run` once a minute how well the depth agrees with the LiDAR
  ORT_DYLIB_PATH   ONNX Runtime's library, if it is not beside the program";

/// Explores a home with one camera, estimates depth, builds a map and records everything.
#[derive(Debug, Parser)]
#[command(name = "firmware-host", version, propagate_version = true, after_help = ENVIRONMENT)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands, each with its arguments.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Explore a simulated home in virtual time, then write a summary, images and a recording.
    #[cfg(feature = "simulator")]
    Explore(ExploreArgs),
    /// Estimate depth on recorded images and measure its accuracy.
    ///
    /// The input is a dataset in the TUM RGB-D layout with a dataset.toml, or a recorded run.
    Perceive(PerceiveArgs),
    /// Recompute every decision of a recorded run. Exits with 0 only if all of them are the same.
    Replay(ReplayArgs),
    /// Extract the seconds around a stop or fault into one small file that `replay` accepts.
    ///
    /// The file is meant for a bug report or a regression test.
    Reproduce(ReproduceArgs),
    /// Render test images of a scene, with ground-truth depth, from random poses on its free floor.
    ///
    /// Each image comes with the coarse depth and some of the earlier images that a robot arriving
    /// there would have.
    #[cfg(feature = "simulator")]
    Views(ViewsArgs),
    /// Drive a real robot with the camera, LiDAR and base named in the configuration.
    Run(RunArgs),
    /// Show the state of the running robot on one screen. Exits with 1 if it is unhealthy.
    Health(HealthArgs),
    /// Send the running robot to a place in its map. It stands there until `resume`.
    GoTo(GoToArgs),
    /// Send the running robot back to where its run began. It stands there until `resume`.
    Return(TaskArgs),
    /// Let the running robot explore again.
    Resume(TaskArgs),
    /// Measure the camera's latency from a recorded run and print the configuration for it.
    ///
    /// The latency is the time from the capture of a frame to its time stamp.
    CameraLatency(CameraLatencyArgs),
    /// Measure wheels, mounts and latencies from a recorded drive, and write calibration.toml.
    ///
    /// Any recorded drive with scans can be used. Two minutes between walls are best, in which the robot
    /// drives straight, drives in arcs, and rotates in both directions. The command itself moves nothing.
    /// It exits with 1 and writes nothing if a result is implausible, or if the robot moved too little
    /// for a result.
    Calibrate(CalibrateArgs),
    /// Localize along a recorded log of another robot and write its trajectory.
    ///
    /// Reads CARMEN logs (FLASER, ODOM, ROBOTLASER1) and the .dat form of a URG-04LX, compressed by
    /// gzip or not.
    Localize(LocalizeArgs),
    /// Save, show and export maps of homes.
    Map(MapArgs),
    /// Install, list, verify and roll back signed depth networks.
    Model(ModelArgs),
    /// Find the connected devices, ask at most fifteen questions, and write a configuration.
    ///
    /// Then the devices are checked as by `check --devices`.
    Init(InitArgs),
    /// Read the mounts of camera and LiDAR from a robot description (URDF), and print them as sections of a configuration.
    Mounts(MountsArgs),
    /// Check a configuration file and print every value in effect, or check the connected devices.
    Check(CheckArgs),
    /// List, verify, recover, export, erase and serve recorded runs.
    Buffer(BufferArgs),
    /// Print the line by which a workstation recognizes this robot: its public key and its name.
    ///
    /// The robot makes its key at its first `run`, and signs its recordings with it. `embodied-depth
    /// prepare --robots FILE` and `buffer verify --robots FILE` read a file with one such line per robot.
    Identity(IdentityArgs),
    /// Print a completion script: `source <(firmware-host completions bash)` completes in this shell.
    Completions {
        /// Shell that reads the script.
        shell: Shell,
    },
    /// Write man pages of this program and its commands.
    #[command(hide = true)]
    ManPages {
        /// Folder for the pages. It is created if it is missing.
        dir: PathBuf,
    },
}

/// Arguments of `firmware-host explore`.
#[derive(Debug, Args)]
pub struct ExploreArgs {
    /// Scene: builtin:apartment?seed=1 (also house, office; `&stairs=1` adds stairs down, `&cables=1` cables on the floor), or
    /// a .glb, .gltf or .obj file.
    #[arg(long)]
    pub scene: String,
    /// How the robot chooses its goals.
    #[arg(long, value_enum, default_value_t = PolicyArg::Active)]
    pub policy: PolicyArg,
    /// Depth network (ONNX file). Without one, dense depth is used.
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Folder of signed models. The robot uses the current one, and switches to a model that is
    /// installed while it drives.
    ///
    /// A newly installed model is on trial at first: if it fails, the robot goes back to the one
    /// before. --model is put into the store as its first model if the store never had one.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["dir", "depth"])]
    pub model_store: Option<PathBuf>,
    /// Depth that the map is made from [default: network if there is a model; without one dense, or
    /// coarse if the configuration has dense.enabled = false].
    #[arg(long, value_parser = depth_source())]
    pub depth: Option<DepthSource>,
    /// Errors of the simulated wheel odometry [default: simulator.odometry of the configuration, which
    /// is realistic by default].
    #[arg(long, value_enum)]
    pub odometry: Option<Odometry>,
    /// Number of camera frames after which the run ends. The robot decides once per frame.
    #[arg(long, value_name = "N", default_value_t = 3000, allow_negative_numbers = true, value_parser = whole_number(1..=10_000_000))]
    pub frames: u64,
    /// Seed of all random choices: start pose, policy, noise.
    #[arg(long, value_name = "N", default_value_t = 1, allow_negative_numbers = true, value_parser = whole_number(0..=u64::MAX))]
    pub seed: u64,
    /// Output folder for the summary, images and recording. It is created if it is missing, and must
    /// not contain another run.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Configuration file. `firmware-host check` prints all keys with their defaults.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Start pose in the scene: x and y in metres, heading in degrees counter-clockwise from the x axis
    /// [default: chosen from the seed].
    #[arg(long, value_name = "X,Y,DEG", allow_hyphen_values = true, value_parser = parse_start)]
    pub start: Option<[f64; 3]>,
    /// Map of the home. It is loaded if the file exists, and the file is replaced with the new map when
    /// the run ends.
    #[arg(long, value_name = "FILE")]
    pub map: Option<PathBuf>,
    #[command(flatten)]
    pub areas: AreaArgs,
    /// Drive to this place in the frame `map` instead of exploring, X and Y in metres, and stand there.
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, value_parser = parse_place)]
    pub go_to: Option<[f64; 2]>,
    /// End the run when all floor that the robot can reach has been seen, and the robot is back at its
    /// start if exploration.return_to_start is set.
    #[arg(long)]
    pub until_done: bool,
    #[command(flatten)]
    pub scene_file: SceneFileArgs,
    /// Do not record the run. It cannot be replayed then.
    #[arg(long)]
    pub no_recording: bool,
    /// Also write the coarse depth of every frame into this folder, for training. The folder is
    /// created if it is missing, and must not contain dump.json of another run.
    #[arg(long, value_name = "DIR")]
    pub dump: Option<PathBuf>,
    /// Show neither the progress nor, on a terminal, what the robot does and why. Warnings and the summary remain.
    #[arg(long, short)]
    pub quiet: bool,
    /// Also write an animation of the growing map into the output folder (animation.png, an
    /// animated PNG of at most 3 MB).
    #[arg(long)]
    pub animation: bool,
    /// Unix socket at which the run serves the program `live-view` [default: live.socket of the
    /// configuration].
    #[arg(long, value_name = "SOCKET")]
    pub live: Option<PathBuf>,
    /// Run in real time instead of as fast as the computer can, so that a person can watch the robot.
    #[arg(long)]
    pub real_time: bool,
    #[command(flatten)]
    pub faults: FaultArgs,
    #[command(flatten)]
    pub hand_over: HandOverArgs,
    #[command(flatten)]
    pub rerun: RerunArgs,
}

/// How to interpret the axes and units of a scene file.
#[derive(Debug, Args, Clone, Copy)]
pub struct SceneFileArgs {
    /// Vertical axis of the scene file [default: for glTF y, unless the surfaces in the file are clearly
    /// horizontal with z up; for OBJ the axis with the larger horizontal surfaces].
    #[arg(long, value_name = "AXIS", value_enum)]
    pub scene_up: Option<UpArg>,
    /// Metres per unit of length in the scene file.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, allow_negative_numbers = true, value_parser = parse_scale)]
    pub scene_scale: f64,
}

/// How `explore` receives better networks from a trainer while it explores (the hand-over).
#[derive(Debug, Args, Default)]
pub struct HandOverArgs {
    /// Folder through which a trainer hands over better networks during the run.
    ///
    /// Before tick --first and every --every ticks after it, the program writes round_NNNN.json into
    /// this folder and waits until model_NNNN.onnx is there.
    #[arg(long = "hand-over", value_name = "DIR", requires_all = ["first", "every"], conflicts_with_all = ["model", "no_recording"])]
    pub dir: Option<PathBuf>,
    /// Number of frames before the first network.
    #[arg(long, value_name = "N", requires = "dir", allow_negative_numbers = true, value_parser = whole_number(1..=u64::MAX))]
    pub first: Option<u64>,
    /// Number of frames between two networks.
    #[arg(long, value_name = "N", requires = "dir", allow_negative_numbers = true, value_parser = whole_number(1..=u64::MAX))]
    pub every: Option<u64>,
}

/// Where to send the live visualization of the run.
#[derive(Debug, Args, Default)]
pub struct RerunArgs {
    /// Also write run.rrd for the Rerun viewer.
    #[cfg(feature = "rerun")]
    #[arg(long)]
    pub rerun: bool,
    /// Also stream to a running Rerun viewer, such as rerun+http://127.0.0.1:9876/proxy.
    #[cfg(feature = "rerun")]
    #[arg(long, value_name = "URL")]
    pub rerun_connect: Option<String>,
}

#[cfg(feature = "rerun")]
impl RerunArgs {
    /// The requested files and viewers; `None` if there are none.
    #[must_use]
    pub fn targets(&self, out: &std::path::Path) -> Option<crate::rerun_stream::RerunTargets> {
        let file = self.rerun.then(|| out.join(crate::rerun_stream::RERUN_FILE));
        let viewer = self.rerun_connect.clone();
        (file.is_some() || viewer.is_some())
            .then_some(crate::rerun_stream::RerunTargets { file, viewer })
    }
}

/// Arguments of `firmware-host run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Configuration file. `firmware-host check` prints all keys with their defaults.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Output folder for the recording and the summary. It is created if it is missing, and must not
    /// contain another run [default: a folder in --runs, named by date, time and run].
    #[arg(long, value_name = "DIR", conflicts_with = "runs")]
    pub out: Option<PathBuf>,
    /// Folder of all runs of this robot [default: models.recordings of the configuration, else the
    /// current folder].
    #[arg(long, value_name = "DIR")]
    pub runs: Option<PathBuf>,
    /// How the robot chooses its goals.
    #[arg(long, value_enum, default_value_t = PolicyArg::Active)]
    pub policy: PolicyArg,
    /// Depth network (ONNX file). Without one, dense depth is used.
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Folder of signed models. The robot uses the current one, and switches to a model that is
    /// installed while it drives [default: models.store of the configuration].
    ///
    /// A newly installed model is on trial at first: if it fails, the robot goes back to the one
    /// before. --model is put into the store as its first model if the store never had one.
    #[arg(long, value_name = "DIR")]
    pub model_store: Option<PathBuf>,
    /// Stop after this number of camera frames [default: run until SIGTERM or Ctrl-C].
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole_number(1..=u64::MAX))]
    pub frames: Option<u64>,
    /// Seed of all random decisions of the robot.
    #[arg(long, value_name = "N", default_value_t = 1, allow_negative_numbers = true, value_parser = whole_number(0..=u64::MAX))]
    pub seed: u64,
    /// Status file that `health` reads [default: run.status_file of the configuration].
    #[arg(long, value_name = "FILE")]
    pub status: Option<PathBuf>,
    /// Map of the home. It is loaded if the file exists, and the file is replaced with the new map when
    /// the run ends.
    #[arg(long, value_name = "FILE")]
    pub map: Option<PathBuf>,
    #[command(flatten)]
    pub areas: AreaArgs,
    /// Do not record the run. It cannot be replayed then.
    #[arg(long)]
    pub no_recording: bool,
    /// Unix socket at which the robot serves the program `live-view` [default: live.socket of the
    /// configuration].
    #[arg(long, value_name = "SOCKET")]
    pub live: Option<PathBuf>,
    #[command(flatten)]
    pub faults: FaultArgs,
}

/// Arguments of `firmware-host identity`.
#[derive(Debug, Args)]
pub struct IdentityArgs {
    /// Configuration file of the robot.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
}

/// Arguments of `firmware-host health`.
#[derive(Debug, Args)]
pub struct HealthArgs {
    /// Status file of the running robot.
    #[arg(long, value_name = "FILE", default_value = "/run/embodied-depth/status.json")]
    pub status: PathBuf,
    /// Print the status file as it is (JSON).
    #[arg(long)]
    pub json: bool,
    /// Update the screen every 0.5 s until interrupted.
    #[arg(long, conflicts_with = "json")]
    pub watch: bool,
}

/// Arguments of `firmware-host go-to`.
#[derive(Debug, Args)]
pub struct GoToArgs {
    /// Place in the frame `map`, metres.
    #[arg(value_name = "X,Y", allow_hyphen_values = true, value_parser = parse_place)]
    pub place: [f64; 2],
    #[command(flatten)]
    pub task: TaskArgs,
}

/// Where the running robot takes its tasks from.
#[derive(Debug, Args)]
pub struct TaskArgs {
    /// Task file of the running robot (run.task_file of its configuration).
    #[arg(long, value_name = "FILE", default_value = "/run/embodied-depth/task.json")]
    pub task_file: PathBuf,
}

/// Arguments of `firmware-host perceive`.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("seen").args(["dataset", "recording"]).required(true)))]
pub struct PerceiveArgs {
    /// Dataset: a folder with rgb.txt, groundtruth.txt, dataset.toml and, for ground truth, depth.txt.
    #[arg(long, value_name = "DIR")]
    pub dataset: Option<PathBuf>,
    /// Recorded run: the --out folder of a run, or one .mcap file. Its own configuration is used
    /// unless --config is given.
    #[arg(long, value_name = "RUN")]
    pub recording: Option<PathBuf>,
    /// Depth network (ONNX file) to evaluate beside coarse depth.
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Output folder for the summary and images. It is created if it is missing, and must not contain
    /// another run.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Also write the coarse depth of every frame into this folder, for training. The folder is
    /// created if it is missing, and must not contain dump.json of another run.
    #[arg(long, value_name = "DIR")]
    pub dump: Option<PathBuf>,
    /// Dump half of the frames as of a robot that has just started: in every second stretch of this many
    /// frames, the dense depth is that of an engine that starts with the stretch. Networks that are
    /// trained on it learn what to do without memory.
    #[arg(long, value_name = "FRAMES", requires = "dump", value_parser = whole_number(1..=10_000))]
    pub restart_every: Option<u64>,
    /// Configuration file. `firmware-host check` prints all keys with their defaults.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// Arguments of `firmware-host calibrate`.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("drive").required(true))]
pub struct CalibrateArgs {
    /// Recorded run: the --out folder of a run, or one .mcap file.
    #[arg(long, value_name = "RUN", group = "source")]
    pub recording: Option<PathBuf>,
    /// Log of another robot: a CARMEN log or the .dat form of a URG-04LX, compressed by gzip or not.
    /// Such a log has no camera frames. Without --out the result is printed and not written.
    #[arg(long, value_name = "FILE", group = "source")]
    pub log: Option<PathBuf>,
    /// Drive the robot of --config first: rotations, stops, straight lines and arcs on 2 x 2 m of free
    /// floor, through its safety plane, and record it.
    #[arg(long, group = "source", requires = "config")]
    pub drive: bool,
    /// Seconds that --drive takes. Two minutes show the mounts; the wheels take five and more.
    #[arg(long, value_name = "S", default_value_t = 120, requires = "drive", value_parser = whole_number(20..=3600))]
    pub seconds: u64,
    /// Start --drive without a question.
    #[arg(long, requires = "drive")]
    pub yes: bool,
    /// Folder of the recording of --drive [default: a folder beside --config, named by date and time].
    #[arg(long, value_name = "DIR", requires = "drive")]
    pub run_out: Option<PathBuf>,
    /// File to write. The robot uses it if the key `calibration` of its configuration names it [default:
    /// calibration.toml beside --config].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Configuration file of the robot, with which the result is compared [default: the configuration
    /// in the recording].
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// Arguments of `firmware-host localize`.
#[derive(Debug, Args)]
pub struct LocalizeArgs {
    /// Log of scans and odometry: a CARMEN log or a URG .dat file, compressed with gzip or not.
    #[arg(long, value_name = "FILE")]
    pub log: PathBuf,
    /// Output folder for trajectory.tum, online.tum, map.png and summary.json. It is created if it is
    /// missing. An earlier result of this command is replaced.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Arguments of `firmware-host map`.
#[derive(Debug, Args)]
pub struct MapArgs {
    #[command(subcommand)]
    pub task: MapTask,
}

/// Subcommands of `map`.
#[derive(Debug, Subcommand)]
pub enum MapTask {
    /// Save the map at the end of a recorded run.
    Save {
        /// Recorded run: the --out folder of a run, or one .mcap file.
        run: PathBuf,
        /// File to write, such as home.map. It must not exist yet.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        #[command(flatten)]
        models: RunModels,
    },
    /// Write a map for other programs: map.yaml and map.pgm (ROS map_server), map.png, walls.geojson.
    Export {
        /// Map file, or a recorded run.
        #[arg(value_name = "FILE|RUN")]
        from: PathBuf,
        /// Output folder. It is created if it is missing, and must not contain a run.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        #[command(flatten)]
        models: RunModels,
    },
    /// Show age, size and content of a map file.
    Show {
        /// Map file to show.
        file: PathBuf,
    },
}

/// Arguments of `firmware-host replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Recorded run: the --out folder of a run, or one .mcap file.
    pub run: PathBuf,
    /// Start at the last segment that begins no later than this tick (1200) or this time since the
    /// first tick (61.5s).
    #[arg(long, value_name = "TICK|SECONDS", allow_negative_numbers = true)]
    pub from: Option<Moment>,
    /// Stop at the first tick whose decision differs from the recorded one.
    #[arg(long)]
    pub until_mismatch: bool,
    #[command(flatten)]
    pub models: RunModels,
}

/// Where to find the networks of a recorded run. A recording contains only their digests.
#[derive(Debug, Args)]
pub struct RunModels {
    /// Depth network that the run was given by --model.
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Folder that the run was given by --hand-over.
    #[arg(long, value_name = "DIR")]
    pub hand_over: Option<PathBuf>,
    /// Folder of signed models that the run was given by --model-store.
    #[arg(long, value_name = "DIR", conflicts_with = "model")]
    pub model_store: Option<PathBuf>,
}

/// Arguments of `firmware-host reproduce`.
#[derive(Debug, Args)]
pub struct ReproduceArgs {
    /// Recorded run: the --out folder of a run, or one .mcap file.
    pub run: PathBuf,
    /// Moment to extract, as a tick (1200) or a time since the first tick (61.5s) [default: the last
    /// stop or fault].
    #[arg(long, value_name = "TICK|SECONDS", allow_negative_numbers = true)]
    pub at: Option<Moment>,
    /// Seconds to extract before that moment, 0 to 3600.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, allow_negative_numbers = true, value_parser = parse_seconds)]
    pub before: f64,
    /// Seconds to extract after that moment, 0 to 3600.
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, allow_negative_numbers = true, value_parser = parse_seconds)]
    pub after: f64,
    /// File to write, such as bug.mcap. It must not exist yet.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    #[command(flatten)]
    pub models: RunModels,
}

/// Arguments of `firmware-host views`.
#[derive(Debug, Args)]
pub struct ViewsArgs {
    /// Scene: builtin:apartment?seed=1 (also house, office), or a .glb, .gltf or .obj file.
    #[arg(long)]
    pub scene: String,
    /// Number of views, 1 to 100000.
    #[arg(long, value_name = "N", default_value_t = 200, allow_negative_numbers = true, value_parser = whole_number(1..=100_000))]
    pub count: u64,
    /// Seed of the random poses.
    #[arg(long, value_name = "N", default_value_t = 1, allow_negative_numbers = true, value_parser = whole_number(0..=u64::MAX))]
    pub seed: u64,
    /// Output folder for the views, in the same format as `perceive --dataset --dump`. It is created
    /// if it is missing, and must not contain dump.json of another run.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Configuration file. `firmware-host check` prints all keys with their defaults.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    #[command(flatten)]
    pub scene_file: SceneFileArgs,
}

/// Arguments of `firmware-host init`.
#[derive(Debug, Args)]
pub struct InitArgs {
    /// Configuration file to write.
    #[arg(long, value_name = "FILE", default_value = "robot.toml")]
    pub out: PathBuf,
    /// Replace the file if it exists. Its keys that no question is about are kept.
    #[arg(long)]
    pub force: bool,
    /// Take the answers from this file (TOML, one key for each question) instead of asking.
    #[arg(long, value_name = "FILE")]
    pub answers: Option<PathBuf>,
    /// Print a file of answers that holds every question with its default, and write nothing.
    #[arg(long, conflicts_with_all = ["answers", "force", "turn_wheels"])]
    pub print_answers: bool,
    /// Rotate each wheel by 90 degrees, to find which motor drives which wheel, the directions and the
    /// gear ratio. The wheels must be off the ground.
    ///
    /// The program asks for a `yes` before anything moves.
    #[arg(long)]
    pub turn_wheels: bool,
    /// Use the simulated devices in this folder (`hil world --dir`) instead of those of the computer.
    #[arg(long, value_name = "DIR")]
    pub simulated: Option<PathBuf>,
}

/// Arguments of `firmware-host mounts`.
#[derive(Debug, Args)]
pub struct MountsArgs {
    /// Robot description (URDF). A xacro file must be converted first: `xacro FILE > robot.urdf`.
    pub urdf: PathBuf,
    /// Link on the floor below the middle of the axle [default: base_footprint].
    #[arg(long, value_name = "LINK")]
    pub base: Option<String>,
    /// Link of the camera. If its name contains `optical`, its z axis is the optical axis, otherwise its x axis [default: the
    /// only link with `optical` in its name].
    #[arg(long, value_name = "LINK")]
    pub camera: Option<String>,
    /// Link of the LiDAR [default: the only link with `laser`, `lidar` or `scan` in its name].
    #[arg(long, value_name = "LINK")]
    pub lidar: Option<String>,
}

/// Arguments of `firmware-host check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Configuration file. Without one, the documented defaults are printed.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Open each configured device for up to three seconds and report its state, instead of printing
    /// the configuration. Exits with 1 unless all devices work.
    ///
    /// No motor is armed and nothing moves.
    #[arg(long, requires = "config")]
    pub devices: bool,
    /// Drive a short course on the floor and compare what is measured with what the safety plane
    /// assumes: reaction time, braking distance, roll-out without commands, wheels, and the
    /// scanner's yaw. Exits with 1 if a measured value is worse than the assumed one.
    ///
    /// The robot moves by up to 0.5 m. A person has to stand beside it.
    #[arg(long, requires = "config", conflicts_with = "devices")]
    pub drive: bool,
    /// With --drive: do not ask before the robot moves.
    #[arg(long, requires = "drive")]
    pub yes: bool,
}

/// Arguments of `firmware-host camera-latency`.
#[derive(Debug, Args)]
pub struct CameraLatencyArgs {
    /// Recorded run: the --out folder of a run, or one .mcap file. One minute in which the robot
    /// rotates left and right is enough.
    pub run: PathBuf,
}

/// Arguments of `firmware-host buffer`.
#[derive(Debug, Args)]
pub struct BufferArgs {
    #[command(subcommand)]
    pub task: BufferTask,
}

/// Subcommands of `buffer`.
#[derive(Debug, Subcommand)]
pub enum BufferTask {
    /// List all segments with their sizes, times, ticks, states and markers (keep, pulled). Reads only the ends of the files.
    List {
        /// A directory of runs, or the --out directory of one run.
        dir: PathBuf,
        /// Print a JSON array with one object per segment, instead of a table.
        #[arg(long)]
        json: bool,
    },
    /// Check all checksums and signatures: which segments are whole, cut or corrupt, and who recorded them. Exits with 1 unless
    /// all can be read and are whole.
    Verify {
        /// A directory of runs, the --out directory of one run, or one segment.
        path: PathBuf,
        /// File of known robots, one per line as `firmware-host identity` prints it. A segment that none of them has signed
        /// does not pass: the command then exits with 1.
        #[arg(long, value_name = "FILE")]
        robots: Option<PathBuf>,
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
    /// Erase one run from this computer: all files of its directory. Prints a receipt with the digest, size and name of each.
    Erase {
        /// The --out directory of one run.
        dir: PathBuf,
        /// Erase the run. Without this option, only the receipt is printed and the exit code is 1.
        #[arg(long)]
        yes: bool,
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
    /// One MCAP file for Foxglove and Rerun: with dates, and with everything in a form that both draw.
    Viewer,
    /// The format of the TUM RGB-D benchmark with localized poses of the camera, which `perceive --dataset` reads.
    Tum,
    /// Refused with the command that writes ROS 2 bags.
    #[value(hide = true)]
    Ros2,
    /// Refused with the command that writes LeRobot datasets.
    #[value(hide = true)]
    Lerobot,
}

/// The values of `--policy`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PolicyArg {
    /// A random step in each frame: forward, left or right.
    Random,
    /// Random segments of 16 steps: 8 left or right, then 8 forward, or 16 forward.
    Heuristic,
    /// Straight ahead; after a collision, a rotation of 10 degrees to the right.
    Forward,
    /// Towards frontiers, where free floor borders on unknown space.
    Frontier,
    /// Towards places where two depth observations disagree.
    Inconsistency,
    /// Frontier and inconsistency goals alternately.
    Active,
    /// No exploration: rotations, stops, lines and arcs on 2 x 2 m, for `calibrate`.
    Calibration,
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
            PolicyArg::Calibration => Self::Calibration,
        }
    }
}

/// A parser of the values of `--depth`: all depth sources that a robot has.
fn depth_source() -> impl TypedValueParser<Value = DepthSource> {
    let values =
        DepthSource::ALL.map(|source| PossibleValue::new(source.name()).help(source.description()));
    PossibleValuesParser::new(values)
        .try_map(|name| DepthSource::from_name(&name).ok_or("no depth source has this name"))
}

/// The values of `--scene-up`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum UpArg {
    /// The convention of glTF.
    Y,
    /// The convention of most 3-D scans.
    Z,
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
        let above_0 = "is not a number above 0";
        let any = "whole number, 0 or more";
        let one = "whole number, 1 or more";
        for (line, range) in [
            ("explore --scene s --out o --frames -1", "whole number from 1 to 10000000"),
            ("explore --scene s --out o --scene-scale -2", above_0),
            ("explore --scene s --out o --seed -1", any),
            ("explore --scene s --out o --fault random --fault-seed -1", any),
            ("explore --scene s --out o --hand-over d --every 1 --first -1", one),
            ("explore --scene s --out o --hand-over d --first 1 --every 0", one),
            ("run --config c --frames -3", one),
            ("run --config c --seed -1", any),
            ("views --scene s --out o --count -1", "whole number from 1 to 100000"),
            ("views --scene s --out o --seed -1", any),
            ("reproduce r --out o --at -1", "neither a tick such as 1200 nor a time"),
            ("model install m --frames -5", "whole number from 1 to 100000"),
        ] {
            let error = Cli::try_parse_from(["firmware-host"].into_iter().chain(line.split(' ')))
                .unwrap_err()
                .to_string();
            let value = line.rsplit(' ').next().unwrap_or_default();
            assert!(error.contains(&format!("invalid value '{value}'")), "{line}: {error}");
            assert!(error.contains(range), "{line}: {error}");
        }
        assert!(
            parse_scale("nan").is_err() && parse_scale("0").is_err() && parse_scale("inf").is_err()
        );
        assert_eq!(parse_scale("0.01"), Ok(0.01));
        assert_eq!(whole_number(1..=5)("5"), Ok(5));
        assert!(whole_number(1..=5)("6").is_err() && whole_number(0..=u64::MAX)("1.5").is_err());
    }

    #[test]
    fn perceive_names_both_kinds_of_input_when_neither_is_given() {
        let error = Cli::try_parse_from(["firmware-host", "perceive", "--out", "o"])
            .unwrap_err()
            .to_string();
        assert!(error.contains("--dataset") && error.contains("--recording"), "{error}");
    }

    #[cfg(feature = "simulator")]
    #[test]
    fn every_depth_source_is_a_value_of_depth_and_the_help_describes_it() {
        use clap::CommandFactory;
        let help = Cli::command()
            .find_subcommand_mut("explore")
            .unwrap()
            .render_long_help()
            .to_string()
            .split_whitespace()
            .collect::<Vec<_>>()
            .join(" ");
        for source in DepthSource::ALL {
            let line =
                ["firmware-host", "explore", "--scene=s", "--out=o", "--depth", source.name()];
            let Command::Explore(args) = Cli::try_parse_from(line).unwrap().command else {
                panic!("not explore");
            };
            assert_eq!(args.depth, Some(source));
            assert!(help.contains(source.description()), "{}: {help}", source.name());
        }
        let line = ["firmware-host", "explore", "--scene=s", "--out=o", "--depth", "lidar"];
        let error = Cli::try_parse_from(line).unwrap_err().to_string();
        assert!(error.contains("coarse, dense, network, truth"), "{error}");
    }

    #[test]
    fn a_start_pose_is_three_finite_numbers() {
        assert_eq!(parse_start("1, -2.5,90"), Ok([1.0, -2.5, 90.0]));
        assert!(parse_start("1,2").is_err());
        assert!(parse_start("1,2,nan").is_err());
    }
}
