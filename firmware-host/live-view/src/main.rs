//! The program. `live-view --help` lists its options.
#![forbid(unsafe_code)]

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Parser;
use live_view::access::{Access, Refused, Tokens};
use live_view::robot::Robot;
use live_view::{layout, server};
use tokio::net::TcpListener;

/// Exit code if the program cannot serve.
const FAILED: u8 = 1;
/// Exit code for a wrong argument; the same code as clap's.
const MISUSED: u8 = 2;

/// Show a running robot in a browser and in Foxglove, and pass an operator's orders on.
///
/// Without --tokens, every program on this computer may watch and steer the robot, and no other
/// computer may. From elsewhere: `ssh -L 8765:127.0.0.1:8765 ROBOT`.
#[derive(Debug, Parser)]
#[command(name = "live-view", version)]
struct Args {
    /// Unix socket of the robot: live.socket of its configuration, or --live of `run` and `explore`.
    #[arg(long, value_name = "SOCKET", default_value = "/run/embodied-depth/live.sock")]
    robot: PathBuf,
    /// Address and port of the page and of Foxglove's WebSocket. Port 0 is any free one.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8765")]
    listen: SocketAddr,
    /// File of tokens, one a line: NAME watch|steer TOKEN. Every client then needs one of them. An
    /// address that other computers can reach needs this file.
    #[arg(long, value_name = "FILE")]
    tokens: Option<PathBuf>,
    /// Also accept pages of this origin without a token, such as https://app.foxglove.dev.
    #[arg(long, value_name = "ORIGIN")]
    allow_origin: Vec<String>,
    /// Write a layout for Foxglove to this file. Import it there by Layouts, Import from file.
    #[arg(long, value_name = "FILE")]
    layout: Option<PathBuf>,
}

fn main() -> ExitCode {
    let args = Args::parse();
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn".into()),
        )
        .with_writer(std::io::stderr)
        .init();
    match run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(if error.is::<Refused>() { MISUSED } else { FAILED })
        }
    }
}

fn run(args: &Args) -> Result<()> {
    let tokens = args.tokens.as_deref().map(Tokens::read).transpose()?;
    let access = Access::new(args.listen.ip(), tokens, args.allow_origin.clone())?;
    if let Some(path) = &args.layout {
        write_layout(path)?;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .context("cannot start the program's threads")?;
    runtime.block_on(serve(args, access))
}

async fn serve(args: &Args, access: Access) -> Result<()> {
    let listener = TcpListener::bind(args.listen).await.with_context(|| {
        format!("cannot listen at {}: is another live-view running? See --listen", args.listen)
    })?;
    let address = listener.local_addr()?;
    let robot = Robot::connect(&args.robot);
    announce(address, &args.robot, &access);
    tokio::select! {
        served = server::serve(listener, robot, access) => served,
        signal = tokio::signal::ctrl_c() => signal.context("cannot listen for signals"),
    }
}

fn announce(address: SocketAddr, robot: &Path, access: &Access) {
    println!("page:     http://{address}/");
    println!("Foxglove: ws://{address}/  (Open connection, Foxglove WebSocket)");
    println!("robot:    {}", robot.display());
    if access.needs_token() {
        println!(
            "Every client needs a token: http://{address}/#token=TOKEN, ws://{address}/?token=TOKEN"
        );
    }
}

fn write_layout(path: &Path) -> Result<()> {
    let json = serde_json::to_string_pretty(&layout())?;
    std::fs::write(path, json)
        .with_context(|| format!("cannot write the layout to {}", path.display()))?;
    println!("layout:   {}", path.display());
    Ok(())
}
