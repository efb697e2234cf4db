//! `push-model`: makes signing keys, signs models, and sends them to a robot or a fleet over the system's ssh.
#![forbid(unsafe_code)]

mod fleet;
mod target;

use std::io::{BufRead, ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use anyhow::{Context, Result, bail};
use clap::{Args, CommandFactory, Parser, Subcommand};
use clap_complete::Shell;
use fleet::FleetArgs;
use signed_model::{Bundle, generate_keys, read_secret_key, sign};
use target::Target;

const USAGE: &str = "push-model [OPTIONS] <MODEL> <TARGET>
       push-model [OPTIONS] <MODEL> --fleet <FILE>
       push-model --fleet <FILE> --status
       push-model <COMMAND>";

/// Send a signed model to a robot, which tests it before it is installed, and show the robot's answer. With --fleet: to many robots.
#[derive(Debug, Parser)]
#[command(
    name = "push-model",
    version,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    override_usage = USAGE,
    after_help = fleet::EXIT_CODES,
    arg_required_else_help = true
)]
struct Cli {
    #[command(flatten)]
    push: PushArgs,
    #[command(subcommand)]
    command: Option<Task>,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Generate a key pair for signing models, and print the line to add to the robots' trusted keys.
    Keygen(KeygenArgs),
    /// Sign NAME.onnx and write the signature to NAME.onnx.minisig.
    Sign(SignArgs),
    /// Print a completion script: `source <(push-model completions bash)` completes in this shell.
    Completions {
        /// Shell that reads the script.
        shell: Shell,
    },
    /// Print the man page: `push-model man | man -l -` shows it.
    Man,
}

#[derive(Debug, Args)]
struct PushArgs {
    /// The model, NAME.onnx. Its signature must be beside it in NAME.onnx.minisig, unless --key is given.
    #[arg(value_name = "MODEL", required_unless_present = "status")]
    bundle: Option<PathBuf>,
    /// The robot as [user@]host or [user@]host:STORE, or the directory of a model store on this computer.
    #[arg(required_unless_present = "fleet", conflicts_with = "fleet")]
    target: Option<String>,
    /// Sign the model with this secret key before sending it.
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// The command that runs firmware-host on the robot, such as "sudo -u embodied-depth firmware-host".
    #[arg(long, value_name = "COMMAND", default_value = "firmware-host")]
    program: String,
    /// Pass an argument to ssh, such as --ssh=-p2222. Can be given several times.
    #[arg(long, value_name = "ARG", allow_hyphen_values = true)]
    ssh: Vec<String>,
    /// Pass an argument to `firmware-host model install`, such as --gate=--unproven. Can be given several times.
    #[arg(long, value_name = "ARG", allow_hyphen_values = true)]
    gate: Vec<String>,
    #[command(flatten)]
    fleet: FleetArgs,
}

#[derive(Debug, Args)]
struct KeygenArgs {
    /// The file to write the secret key to. The public key is written to FILE.pub.
    #[arg(value_name = "FILE")]
    key: PathBuf,
    /// A name for the key in the robots' trusted keys.
    #[arg(long, default_value = "", value_name = "TEXT")]
    comment: String,
    /// Do not encrypt the secret key. Anyone who can read the file can then sign models.
    #[arg(long)]
    no_password: bool,
}

#[derive(Debug, Args)]
struct SignArgs {
    /// The model, NAME.onnx.
    model: PathBuf,
    /// The secret key to sign with.
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// The name of the model [default: NAME].
    #[arg(long)]
    name: Option<String>,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match cli.command {
        Some(Task::Keygen(args)) => keygen(&args).map(|()| ExitCode::SUCCESS),
        Some(Task::Sign(args)) => {
            sign_file(&args.model, &args.key, args.name).map(|()| ExitCode::SUCCESS)
        }
        Some(Task::Completions { shell }) => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "push-model", &mut script);
            print(&script)
        }
        Some(Task::Man) => man_page().and_then(|page| print(&page)),
        None => push(&cli.push),
    };
    result.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::FAILURE
    })
}

fn man_page() -> Result<Vec<u8>> {
    let mut page = Vec::new();
    clap_mangen::Man::new(Cli::command()).render(&mut page)?;
    Ok(page)
}

/// Prints to standard output, whose reader may close it.
fn print(text: &[u8]) -> Result<ExitCode> {
    match std::io::stdout().write_all(text) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(error).context("cannot write to standard output")
        }
        _ => Ok(ExitCode::SUCCESS),
    }
}

fn keygen(args: &KeygenArgs) -> Result<()> {
    let password = if args.no_password {
        None
    } else {
        let password = prompt("Password for the secret key: ")?;
        if password.is_empty() {
            bail!("the password is empty; enter one, or give --no-password");
        }
        Some(password)
    };
    let public = generate_keys(&args.key, password, &args.comment)?;
    print(format!("{public}\n").as_bytes())?;
    eprintln!(
        "Add this line to /etc/embodied-depth/trusted_keys on every robot that should accept your models. Keep the secret key off the robots."
    );
    Ok(())
}

fn sign_file(model: &Path, key: &Path, name: Option<String>) -> Result<()> {
    if model.extension() != Some("onnx".as_ref()) {
        bail!(
            "{} is not named NAME.onnx; give the file that `embodied-depth export` wrote",
            model.display()
        );
    }
    let name = name.map_or_else(|| Bundle::name_of(model), Ok)?;
    let bytes = std::fs::read(model).with_context(|| format!("cannot read {}", model.display()))?;
    let key = read_secret_key(key, || prompt("Password of the secret key: "))?;
    let path = Bundle::signature_path(model);
    let partial = path.with_extension("minisig.partial");
    std::fs::write(&partial, sign(&bytes, &name, &key)?)
        .and_then(|()| std::fs::rename(&partial, &path))
        .with_context(|| format!("cannot write {}", path.display()))?;
    eprintln!("signed {name}: {}", path.display());
    Ok(())
}

/// The model with its signature, which is made first if there is a key.
fn signed_bundle(args: &PushArgs) -> Result<Bundle> {
    let model = args.bundle.as_deref().context("the model is missing; give NAME.onnx")?;
    if let Some(key) = &args.key {
        sign_file(model, key, None)?;
    }
    Ok(Bundle::read_files(model)?)
}

fn push(args: &PushArgs) -> Result<ExitCode> {
    if let Some(file) = &args.fleet.fleet {
        return Ok(fleet::run(args, file));
    }
    let bundle = signed_bundle(args)?;
    let to = args.target.as_deref().context("the robot is missing; give [user@]host")?;
    let target = Target::parse(to)?;
    let mut command = target.command(&args.program, &args.ssh);
    command.args(target.install_arguments(&args.gate)).stdin(Stdio::piped());
    let mut child = command
        .spawn()
        .with_context(|| format!("cannot start {}", command.get_program().display()))?;
    let mut input = child.stdin.take().context("no standard input")?;
    let mib = bundle.model.len() as f64 / f64::from(1 << 20);
    eprintln!("sending {} ({mib:.1} MiB) to {to}", bundle.name);
    let sent = bundle.write_stream(&mut input);
    drop(input);
    let status = child.wait()?;
    match sent {
        // If the robot's program failed, it has printed why it closed the connection.
        Err(error) if status.success() => Err(error).context("the bundle was not sent completely"),
        _ => Ok(ExitCode::from(status.code().map_or(1, |code| code as u8))),
    }
}

/// Reads a line from standard input; on a terminal without echo, if possible.
fn prompt(question: &str) -> std::io::Result<String> {
    let stdin = std::io::stdin();
    let is_terminal = stdin.is_terminal();
    if is_terminal {
        eprint!("{question}");
        std::io::stderr().flush()?;
        set_echo(false);
    }
    let mut line = String::new();
    let read = stdin.lock().read_line(&mut line);
    if is_terminal {
        set_echo(true);
        eprintln!();
    }
    read.map(|_| line.trim_end_matches(['\r', '\n']).to_owned())
}

fn set_echo(on: bool) {
    // If stty fails, the password is echoed but accepted nevertheless.
    let _ = Command::new("stty").arg(if on { "echo" } else { "-echo" }).status();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn completions_and_the_man_page_are_commands_and_the_command_line_is_consistent() {
        Cli::command().debug_assert();
        let cli = Cli::parse_from(["push-model", "completions", "bash"]);
        assert!(matches!(cli.command, Some(Task::Completions { shell: Shell::Bash })));
        assert!(matches!(Cli::parse_from(["push-model", "man"]).command, Some(Task::Man)));
        let page = man_page().unwrap_or_default();
        assert!(String::from_utf8_lossy(&page).contains("keygen"));
    }
}
