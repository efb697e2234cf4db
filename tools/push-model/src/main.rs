//! `push-model`: signs a model, sends it to a robot over the system's own ssh, and shows what the robot's gate says.
#![forbid(unsafe_code)]

mod target;

use std::io::{BufRead, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use anyhow::{Context, Result, bail};
use clap::{Args, Parser, Subcommand};
use signed_model::{Bundle, generate_keys, read_secret_key, sign};
use target::Target;

/// Sends a signed model to a robot.
#[derive(Debug, Parser)]
#[command(
    name = "push-model",
    version,
    args_conflicts_with_subcommands = true,
    arg_required_else_help = true
)]
struct Cli {
    #[command(flatten)]
    push: Option<PushArgs>,
    #[command(subcommand)]
    command: Option<Task>,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Make a key pair that signs models, and print the line for the robots' trusted keys.
    Keygen(KeygenArgs),
    /// Write NAME.onnx.minisig beside NAME.onnx.
    Sign(SignArgs),
}

#[derive(Debug, Args)]
struct PushArgs {
    /// NAME.onnx, with NAME.onnx.minisig beside it unless --key is given.
    bundle: PathBuf,
    /// [user@]host, [user@]host:STORE, or the folder of a store on this computer.
    target: String,
    /// Secret key: signs the model first.
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// The robot's program, as its shell takes it, such as "sudo -u embodied-depth firmware-host".
    #[arg(long, value_name = "COMMAND", default_value = "firmware-host")]
    program: String,
    /// Passed on to ssh, such as -p2222. May be given more than once.
    #[arg(long, value_name = "OPTION", allow_hyphen_values = true)]
    ssh: Vec<String>,
    /// Passed on to `firmware-host model install`, such as --unproven. May be given more than once.
    #[arg(long, value_name = "ARGUMENT", allow_hyphen_values = true)]
    gate: Vec<String>,
}

#[derive(Debug, Args)]
struct KeygenArgs {
    /// File for the secret key; the public key goes into FILE.pub.
    key: PathBuf,
    /// Who this is, for the robots' lists of trusted keys.
    #[arg(long, default_value = "")]
    comment: String,
    /// No password: whoever reads the file signs.
    #[arg(long)]
    no_password: bool,
}

#[derive(Debug, Args)]
struct SignArgs {
    /// NAME.onnx.
    model: PathBuf,
    /// Secret key.
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// What the model is called [default: NAME].
    #[arg(long)]
    name: Option<String>,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match (cli.command, cli.push) {
        (Some(Task::Keygen(args)), _) => keygen(&args).map(|()| ExitCode::SUCCESS),
        (Some(Task::Sign(args)), _) => {
            sign_file(&args.model, &args.key, args.name).map(|()| ExitCode::SUCCESS)
        }
        (None, Some(args)) => push(&args),
        (None, None) => Ok(ExitCode::from(2)),
    };
    result.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::FAILURE
    })
}

fn keygen(args: &KeygenArgs) -> Result<()> {
    let password = if args.no_password {
        None
    } else {
        let password = ask("Password for the secret key: ")?;
        if password.is_empty() {
            bail!("an empty password protects nothing; give one, or --no-password");
        }
        Some(password)
    };
    println!("{}", generate_keys(&args.key, password, &args.comment)?);
    eprintln!(
        "Put this line into /etc/embodied-depth/trusted_keys of every robot that shall take your models."
    );
    Ok(())
}

fn sign_file(model: &Path, key: &Path, name: Option<String>) -> Result<()> {
    if model.extension() != Some("onnx".as_ref()) {
        bail!(
            "{} is not called NAME.onnx; give the file that `embodied-depth export` wrote",
            model.display()
        );
    }
    let name = name.map_or_else(|| Bundle::name_of(model), Ok)?;
    let bytes = std::fs::read(model).with_context(|| format!("cannot read {}", model.display()))?;
    let key = read_secret_key(key, || ask("Password of the secret key: "))?;
    let path = Bundle::signature_path(model);
    let partial = path.with_extension("minisig.partial");
    std::fs::write(&partial, sign(&bytes, &name, &key)?)
        .and_then(|()| std::fs::rename(&partial, &path))
        .with_context(|| format!("cannot write {}", path.display()))?;
    eprintln!("signed {name}: {}", path.display());
    Ok(())
}

fn push(args: &PushArgs) -> Result<ExitCode> {
    if let Some(key) = &args.key {
        sign_file(&args.bundle, key, None)?;
    }
    let bundle = Bundle::read_files(&args.bundle)?;
    let target = Target::parse(&args.target)?;
    let mut command = match &target {
        Target::Local { .. } => Command::new(beside_this(&args.program)),
        Target::Remote { host, .. } => {
            let mut ssh = Command::new("ssh");
            ssh.args(&args.ssh).arg("--").arg(host).arg(&args.program);
            ssh
        }
    };
    command.args(target.install_arguments(&args.gate)).stdin(Stdio::piped());
    let mut child = command
        .spawn()
        .with_context(|| format!("cannot start {}", command.get_program().display()))?;
    let mut input = child.stdin.take().context("no standard input")?;
    let mib = bundle.model.len() as f64 / f64::from(1 << 20);
    eprintln!("sending {} ({mib:.1} MiB) to {}", bundle.name, args.target);
    let sent = bundle.write_stream(&mut input);
    drop(input);
    let status = child.wait()?;
    match sent {
        // The other side says why it hung up.
        Err(error) if status.success() => Err(error).context("the bundle was not sent whole"),
        _ => Ok(ExitCode::from(status.code().map_or(1, |code| code as u8))),
    }
}

/// The program of that name beside this one, where there is one; else as the system finds it.
fn beside_this(program: &str) -> PathBuf {
    let beside = std::env::current_exe().ok().and_then(|this| Some(this.parent()?.join(program)));
    beside.filter(|path| path.is_file()).unwrap_or_else(|| program.into())
}

/// A line from the terminal, unseen where that is possible; from standard input, as it comes.
fn ask(question: &str) -> std::io::Result<String> {
    let stdin = std::io::stdin();
    let terminal = stdin.is_terminal();
    if terminal {
        eprint!("{question}");
        std::io::stderr().flush()?;
        echo(false);
    }
    let mut line = String::new();
    let read = stdin.lock().read_line(&mut line);
    if terminal {
        echo(true);
        eprintln!();
    }
    read.map(|_| line.trim_end_matches(['\r', '\n']).to_owned())
}

fn echo(on: bool) {
    // Without stty the password is seen; it is taken all the same.
    let _ = Command::new("stty").arg(if on { "echo" } else { "-echo" }).status();
}
