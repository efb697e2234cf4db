//! The figures in docs/live-view.md. Nothing here can fail by being slow.

use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use hil::world::{LiveOptions, LiveWorld};
use live_view::access::{Access, Transport};
use live_view::robot::Robot;
use live_view::server;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::{Builder, Runtime};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

use super::explore::Explore;

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

const STOPS: usize = 200;
/// Drives of each kind on simulated devices, and how long each takes.
const DRIVES: usize = 5;
const DRIVE: Duration = Duration::from_secs(30);

async fn serve(socket: &Path) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let access = Access::new(address.ip(), Transport::Plain, None, Vec::new()).unwrap();
    tokio::spawn(server::serve(listener, Robot::connect(socket), access));
    format!("ws://{address}/")
}

/// Connects and subscribes everything. Returns the socket, and the topics by their subscriptions.
async fn connect(url: &str) -> (Socket, Vec<String>) {
    let mut request = url.into_client_request().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", "foxglove.sdk.v1".parse().unwrap());
    let (mut socket, _) = connect_async(request).await.unwrap();
    loop {
        let Message::Text(text) = socket.next().await.unwrap().unwrap() else { continue };
        let message: Value = serde_json::from_str(&text).unwrap();
        let Some(channels) = message["channels"].as_array().filter(|list| !list.is_empty()) else {
            continue;
        };
        let topics = channels.iter().map(|channel| channel["topic"].as_str().unwrap().to_owned());
        let subscriptions: Vec<_> = channels
            .iter()
            .map(|channel| json!({"id": channel["id"], "channelId": channel["id"]}))
            .collect();
        let subscribe = json!({"op": "subscribe", "subscriptions": subscriptions});
        socket.send(Message::Text(subscribe.to_string().into())).await.unwrap();
        return (socket, topics.collect());
    }
}

fn percentile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "prints figures for the documentation"]
async fn figures_of_the_link() {
    println!("explore --real-time:");
    let run = Explore::with("", &["--seed", "1", "--no-recording"]);
    print_figures_of(&run.socket()).await;
    drop(run);

    println!("run on simulated devices:");
    let folder = tempfile::tempdir().unwrap();
    let world = LiveWorld::start(folder.path(), &LiveOptions::default()).unwrap();
    let socket = add_live_view(&world, folder.path());
    let mut robot = start(&world, folder.path());
    print_figures_of(&socket).await;
    kill_process(Pid::from_raw(robot.id() as i32).unwrap(), Signal::TERM).unwrap();
    assert!(robot.wait().unwrap().success());
}

/// Adds a live view to the configuration of a robot in a simulated world. Returns its socket.
fn add_live_view(world: &LiveWorld, folder: &Path) -> PathBuf {
    let socket = folder.join("live.sock");
    let config = std::fs::read_to_string(world.config()).unwrap();
    let live = format!("[live]\nsocket = {socket:?}\n");
    std::fs::write(world.config(), config + &live).unwrap();
    socket
}

/// Starts `firmware-host run` in a simulated world.
fn start(world: &LiveWorld, folder: &Path) -> Child {
    Command::new(assert_cmd::cargo::cargo_bin!("firmware-host"))
        .args(["run", "--config"])
        .arg(world.config())
        .arg("--out")
        .arg(folder.join("run"))
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap()
}

/// Prints how long the first map and the answers to STOP of a robot take.
async fn print_figures_of(socket: &Path) {
    let url = serve(socket).await;
    // The robot's map has begun.
    tokio::time::sleep(Duration::from_secs(5)).await;
    let mut firsts = Vec::new();
    for _ in 0..20 {
        let began = Instant::now();
        let (mut socket, topics) = connect(&url).await;
        let map = topics.iter().position(|topic| topic == "/map").unwrap() as u32;
        loop {
            let message = socket.next().await.unwrap().unwrap();
            if let Message::Binary(bytes) = message
                && bytes[..5] == [&[1], &map.to_le_bytes()[..]].concat()
            {
                break;
            }
        }
        firsts.push(began.elapsed().as_secs_f64() * 1e3);
    }
    firsts.sort_by(f64::total_cmp);
    println!(
        "first map: median {:.0} ms, worst {:.0} ms",
        percentile(&firsts, 0.5),
        percentile(&firsts, 1.0)
    );

    let (mut socket, _) = connect(&url).await;
    let mut times = Vec::new();
    for call in 0..STOPS as u32 {
        // A stop of a robot that drives: it is armed before.
        for (service, measured) in [(3u32, false), (1u32, true)] {
            let began = Instant::now();
            let head = [&[2][..], &service.to_le_bytes(), &call.to_le_bytes(), &4u32.to_le_bytes()];
            let bytes = [head.concat(), b"json{}".to_vec()].concat();
            socket.send(Message::Binary(bytes.into())).await.unwrap();
            loop {
                let message = socket.next().await.unwrap().unwrap();
                let Message::Binary(bytes) = message else { continue };
                if bytes[0] == 3 {
                    let said = String::from_utf8_lossy(&bytes);
                    if measured {
                        assert!(said.contains("has stopped the robot"), "{said}");
                        times.push(began.elapsed().as_secs_f64() * 1e3);
                    }
                    break;
                }
            }
            // Fewer than five orders a second, and time to arm.
            tokio::time::sleep(Duration::from_millis(450)).await;
        }
    }
    times.sort_by(f64::total_cmp);
    let [p50, p99, worst] = [0.5, 0.99, 1.0].map(|share| percentile(&times, share));
    println!(
        "STOP over loopback until the safety plane has confirmed: p50 {p50:.1}, p99 {p99:.1}, worst {worst:.1} ms"
    );
}

/// The view, and clients that subscribe everything and read what comes, until they are dropped. The clients of a robot are other
/// computers: here they have the lowest priority, so that they take as little as possible of what robot and view need.
struct Watched {
    view: tokio::task::JoinHandle<()>,
    clients: Option<Runtime>,
}

impl Watched {
    fn begin(socket: PathBuf, count: usize) -> Self {
        let clients = Builder::new_multi_thread()
            .worker_threads(2)
            .on_thread_start(|| _ = rustix::process::nice(19))
            .enable_all()
            .build()
            .unwrap();
        let handle = clients.handle().clone();
        let view = tokio::spawn(async move {
            let url = serve(&socket).await;
            for _ in 0..count {
                let url = url.clone();
                handle.spawn(async move {
                    let (mut socket, _) = connect(&url).await;
                    while let Some(Ok(_)) = socket.next().await {}
                });
            }
        });
        Self { view, clients: Some(clients) }
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        self.view.abort();
        self.clients.take().into_iter().for_each(Runtime::shutdown_background);
    }
}

fn latencies(folder: &Path) -> Value {
    let summary = std::fs::read_to_string(folder.join("run/summary.json")).unwrap();
    let summary: Value = serde_json::from_str(&summary).unwrap();
    summary["latency_ms"].clone()
}

/// The latencies of `firmware-host run` on simulated devices for [`DRIVE`], with this number of clients.
async fn drive(clients: Option<usize>) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let world = LiveWorld::start(folder.path(), &LiveOptions::default()).unwrap();
    let view = clients.map(|clients| {
        let socket = add_live_view(&world, folder.path());
        Watched::begin(socket, clients)
    });
    let mut robot = start(&world, folder.path());
    tokio::time::sleep(DRIVE).await;
    kill_process(Pid::from_raw(robot.id() as i32).unwrap(), Signal::TERM).unwrap();
    let status = tokio::task::spawn_blocking(move || robot.wait().unwrap()).await.unwrap();
    assert!(status.success());
    drop(view);
    println!("  {:.1} m driven", world.home().score().1);
    latencies(folder.path())
}

/// Prints the median of each figure over all runs of a kind, and the figures of each run.
fn compare(kinds: [(&str, &[Value]); 2]) {
    for figure in ["total/p50", "total/p99", "safety_late/p50", "safety_late/p99", "live/p99"] {
        for (kind, runs) in kinds {
            let mut all: Vec<f64> = runs
                .iter()
                .filter_map(|run| run.pointer(&format!("/{figure}")).and_then(Value::as_f64))
                .collect();
            let each: Vec<String> = all.iter().map(|ms| format!("{ms:.3}")).collect();
            all.sort_by(f64::total_cmp);
            if !all.is_empty() {
                let median = percentile(&all, 0.5);
                println!("{figure:16} {kind:15} median {median:.3} ms of {}", each.join(", "));
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "prints figures for the documentation"]
async fn cost_of_the_view_to_a_robot() {
    let mut without = Vec::new();
    let mut with = Vec::new();
    for _ in 0..DRIVES {
        without.push(drive(None).await);
        with.push(drive(Some(3)).await);
    }
    compare([("without", &without), ("with 3 clients", &with)]);
}
