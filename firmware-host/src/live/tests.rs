//! A socket with its clients, without a robot.

use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

use live_link::{Frame, FrameReader, Line, Order, OrderLine, frame};
use runtime::operator::{OperatorOrder, Role};
use runtime::safety::SafetyState;

use super::channels::Topic;
use super::hub::{Hub, MOST_CLIENTS};
use super::order_handler::{Abilities, OrderHandler};
use super::rate::pause;
use super::socket::Server;
use crate::control_panel::{ControlPanel, PanelReader};

pub(super) fn after_ms(began: Instant, ms: u64) -> Instant {
    began + Duration::from_millis(ms)
}

const CANNOT: Abilities =
    Abilities { keeps_map: false, plans_paths: false, keeps_out: false, drawn: 0 };

struct Served {
    dir: tempfile::TempDir,
    hub: Arc<Hub>,
    safety: PanelReader,
    notes: Receiver<OperatorOrder>,
    server: Server,
}

fn serve() -> Served {
    let dir = tempfile::tempdir().unwrap();
    let hub = Arc::new(Hub::default());
    let panel = ControlPanel::default();
    let safety = PanelReader::new(panel.clone());
    let (note_sender, notes) = sync_channel(100);
    let handler = OrderHandler::new(panel, sync_channel(9).0, note_sender, CANNOT);
    let server =
        Server::start(&dir.path().join("live.sock"), Arc::clone(&hub), Arc::new(handler)).unwrap();
    Served { dir, hub, safety, notes, server }
}

struct TestClient {
    stream: UnixStream,
    reader: FrameReader,
}

impl TestClient {
    fn connect(served: &Served) -> Self {
        let stream = UnixStream::connect(served.dir.path().join("live.sock")).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        Self { stream, reader: FrameReader::default() }
    }

    fn say(&mut self, line: &Line) {
        self.stream.write_all(&line.to_bytes().unwrap()).unwrap();
    }

    /// The next frame that is no channel; `None` at the end of the connection.
    fn next(&mut self) -> Option<Frame> {
        let mut piece = [0; 16384];
        loop {
            match self.reader.next_frame().unwrap() {
                Some(Frame::Channels(_)) => {}
                Some(frame) => return Some(frame),
                None => match self.stream.read(&mut piece) {
                    Ok(count) if count > 0 => self.reader.push(&piece[..count]),
                    _ => return None,
                },
            }
        }
    }
}

fn wait_for(what: impl Fn() -> bool) {
    let began = Instant::now();
    while !what() {
        assert!(began.elapsed() < Duration::from_secs(20), "it never happened");
        pause(Duration::from_millis(2));
    }
}

fn stop() -> Line {
    let who = "test".to_owned();
    Line::Order(OrderLine { id: 1, who, role: Role::Steer, order: Order::Stop })
}

#[test]
fn the_socket_is_its_owners_alone_and_goes_with_the_server() {
    let served = serve();
    let path = served.dir.path().join("live.sock");
    assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    let Served { server, dir: _dir, .. } = served;
    drop(server);
    assert!(!path.exists());
}

#[test]
fn a_socket_that_another_robot_serves_and_a_file_are_left_alone() {
    let served = serve();
    assert!(refusal_to_serve(&served.dir.path().join("live.sock")).contains("another robot"));
    let file = served.dir.path().join("file");
    std::fs::write(&file, "mine").unwrap();
    assert!(refusal_to_serve(&file).contains("not a socket"));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "mine");
}

fn refusal_to_serve(path: &Path) -> String {
    let handler =
        OrderHandler::new(ControlPanel::default(), sync_channel(1).0, sync_channel(1).0, CANNOT);
    Server::start(path, Arc::default(), Arc::new(handler)).err().unwrap().to_string()
}

#[test]
fn a_client_that_never_reads_is_cut_off_and_the_others_get_everything_in_time() {
    let served = serve();
    let mut slow = TestClient::connect(&served);
    slow.say(&Line::Subscribe(vec![Topic::Map.id()]));
    let mut good = TestClient::connect(&served);
    good.say(&Line::Subscribe(vec![Topic::Scan.id()]));
    wait_for(|| served.hub.wants(Topic::Map) && served.hub.wants(Topic::Scan));
    let large: Arc<[u8]> = frame::message(Topic::Map.id(), 1, &vec![7; 1 << 20]).unwrap().into();
    let small: Arc<[u8]> = frame::message(Topic::Scan.id(), 2, b"scan").unwrap().into();
    for _ in 0..50 {
        served.hub.send(Topic::Map, &large);
        served.hub.send(Topic::Scan, &small);
    }
    for _ in 0..50 {
        assert!(matches!(good.next(), Some(Frame::Message { time_ns: 2, .. })));
    }
    wait_for(|| !served.hub.wants(Topic::Map));
    assert!(served.hub.wants(Topic::Scan));
}

#[test]
fn rubbish_is_noted_and_answered_and_the_next_order_counts() {
    let mut served = serve();
    served.safety.publish(SafetyState::Disarmed);
    let mut client = TestClient::connect(&served);
    client.stream.write_all(b"GET / HTTP/1.1\n{\"order\":7}\n\xff\xfe\n").unwrap();
    for _ in 0..3 {
        assert!(matches!(client.next(), Some(Frame::Answer(answer)) if !answer.accepted));
        assert!(served.notes.recv().unwrap().refused.is_some());
    }
    client.say(&stop());
    assert!(matches!(client.next(), Some(Frame::Answer(answer)) if answer.accepted));
    assert!(served.safety.orders().emergency_stop);
}

#[test]
fn more_clients_than_are_allowed_are_turned_away() {
    let served = serve();
    let mut clients: Vec<_> = (0..MOST_CLIENTS).map(|_| TestClient::connect(&served)).collect();
    served.safety.publish(SafetyState::Disarmed);
    for guest in &mut clients {
        guest.say(&stop());
        assert!(matches!(guest.next(), Some(Frame::Answer(_))));
    }
    let mut late = TestClient::connect(&served);
    assert!(late.next().is_none());
}
