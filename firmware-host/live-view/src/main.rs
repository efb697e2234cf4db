//! The program. `live-view --help` lists its options.
#![forbid(unsafe_code)]

use std::fmt;
use std::io::{self, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context, Result};
use clap::Parser;
use live_view::access::{Access, Refused, Tokens, Transport};
use live_view::robot::Robot;
use live_view::tls::{self, TlsListener};
use live_view::{layout, server};
use rustls::ServerConfig;
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
    /// Address and port of the page and of Foxglove's WebSocket. Port 0 chooses any free port.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8765")]
    listen: SocketAddr,
    /// File of tokens, one a line: NAME watch|steer TOKEN. Every client then needs one of them. An
    /// address that other computers can reach needs this file.
    #[arg(long, value_name = "FILE")]
    tokens: Option<PathBuf>,
    /// Certificate chain in PEM: page and WebSocket then use TLS. An address that other computers can
    /// reach needs it, unless --no-tls is given.
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    tls_certificate: Option<PathBuf>,
    /// Key of the certificate in PEM, readable by its owner only.
    #[arg(long, value_name = "FILE", requires = "tls_certificate")]
    tls_key: Option<PathBuf>,
    /// Listen without TLS at an address that other computers can reach, because a VPN or a proxy protects
    /// the connection.
    #[arg(long, conflicts_with = "tls_certificate")]
    no_tls: bool,
    /// Also accept pages of this origin without a token, such as https://app.foxglove.dev.
    #[arg(long, value_name = "ORIGIN")]
    allow_origin: Vec<String>,
    /// Write a layout for Foxglove to this file. In Foxglove, `Layouts`, `Import from file` reads it.
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
    let pair = args.tls_certificate.as_deref().zip(args.tls_key.as_deref());
    let tls = pair.map(|(certificate, key)| tls::config(certificate, key)).transpose()?;
    let transport = match (&tls, args.no_tls) {
        (Some(_), _) => Transport::Tls,
        (None, true) => Transport::ProtectedElsewhere,
        (None, false) => Transport::Plain,
    };
    let access = Access::new(args.listen.ip(), transport, tokens, args.allow_origin.clone())?;
    if let Some(path) = &args.layout {
        write_layout(path)?;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .context("cannot start the program's threads")?;
    runtime.block_on(serve(args, access, tls))
}

async fn serve(args: &Args, access: Access, tls: Option<Arc<ServerConfig>>) -> Result<()> {
    let listener = TcpListener::bind(args.listen).await.with_context(|| {
        format!("cannot listen at {}: is another live-view running? See --listen", args.listen)
    })?;
    let address = listener.local_addr()?;
    let robot = Robot::connect(&args.robot);
    announce(address, &args.robot, &access, tls.is_some());
    let serves = async {
        match tls {
            Some(config) => server::serve(TlsListener::new(listener, config)?, robot, access).await,
            None => server::serve(listener, robot, access).await,
        }
    };
    tokio::select! {
        served = serves => served,
        signal = tokio::signal::ctrl_c() => signal.context("cannot listen for signals"),
    }
}

fn announce(address: SocketAddr, robot: &Path, access: &Access, has_tls: bool) {
    let [http, ws] = if has_tls { ["https", "wss"] } else { ["http", "ws"] };
    print_line(format_args!("page:     {http}://{address}/"));
    print_line(format_args!("Foxglove: {ws}://{address}/  (Open connection, Foxglove WebSocket)"));
    print_line(format_args!("robot:    {}", robot.display()));
    if access.needs_token() {
        print_line(format_args!(
            "Every client needs a token: {http}://{address}/#token=TOKEN, {ws}://{address}/?token=TOKEN"
        ));
    }
}

fn write_layout(path: &Path) -> Result<()> {
    let json = serde_json::to_string_pretty(&layout())?;
    std::fs::write(path, json)
        .with_context(|| format!("cannot write the layout to {}", path.display()))?;
    print_line(format_args!("layout:   {}", path.display()));
    Ok(())
}

/// Prints a line if standard output is read. `println!` panics if it is not, as in `live-view | head -1`.
fn print_line(line: fmt::Arguments<'_>) {
    let _ = writeln!(io::stdout(), "{line}");
}
