//! A simulated robot that explores in real time, and a client of its socket.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use hal::Clock;
use live_link::{Answer, Frame, FrameReader, Line, Order, OrderLine};
use monotonic_clock::MonotonicClock;
use runtime::operator::Role;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

/// Long enough for a computer that does something else as well.
pub const PATIENCE: Duration = Duration::from_secs(60);

const CONFIG: &str = "[camera]\nwidth = 320\nheight = 96\n";

/// A run of `explore` with its folder.
pub struct Explore {
    pub folder: tempfile::TempDir,
    child: Child,
}

impl Explore {
    pub fn start(args: &[&str]) -> Self {
        Self::with(CONFIG, args)
    }

    pub fn with(config: &str, args: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("robot.toml"), config).unwrap();
        let child = Command::new(assert_cmd::cargo::cargo_bin!("firmware-host"))
            .args(["explore", "--scene", "builtin:apartment?seed=1", "--frames", "1000000"])
            .args(["--real-time", "--config", "robot.toml", "--out", "run", "--live", "live.sock"])
            .args(args)
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let run = Self { folder, child };
        run.wait("the socket", |run| UnixStream::connect(run.socket()).is_ok());
        run
    }

    pub fn socket(&self) -> PathBuf {
        self.path("live.sock")
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn wait(&self, what: &str, done: impl Fn(&Self) -> bool) {
        let began = Instant::now();
        while !done(self) {
            assert!(began.elapsed() < PATIENCE, "{what} did not happen");
            let mut clock = MonotonicClock;
            clock.sleep_until_ns(clock.now_ns() + 20_000_000);
        }
    }

    /// Ends the run as Ctrl-C does; it reports and exits.
    pub fn end(&mut self) {
        self.signal(Signal::INT);
        assert!(self.child.wait().unwrap().success());
    }

    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_raw(self.child.id() as i32).unwrap(), signal).unwrap();
    }

    /// Ends the process at once, as a crash does.
    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Explore {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A client of the socket.
pub struct Visitor {
    stream: UnixStream,
    reader: FrameReader,
    topics: Vec<String>,
    answer: Option<Answer>,
}

impl Visitor {
    pub fn come(socket: &Path) -> Self {
        let stream = UnixStream::connect(socket).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut visitor =
            Self { stream, reader: FrameReader::default(), topics: Vec::new(), answer: None };
        let Frame::Channels(channels) = visitor.frame() else { panic!("no channels first") };
        visitor.topics = channels.into_iter().map(|channel| channel.topic).collect();
        visitor
    }

    pub fn subscribe(&mut self, topics: &[&str]) {
        let ids = topics.iter().map(|topic| self.topics.iter().position(|it| it == topic).unwrap());
        let line = Line::Subscribe(ids.map(|id| id as u16).collect());
        self.stream.write_all(&line.to_bytes().unwrap()).unwrap();
    }

    /// Gives an order and waits for its answer.
    pub fn order(&mut self, role: Role, order: Order) -> Answer {
        let line = Line::Order(OrderLine { id: 5, who: "the test".to_owned(), role, order });
        self.stream.write_all(&line.to_bytes().unwrap()).unwrap();
        loop {
            if let Some(answer) = self.answer.take() {
                return answer;
            }
            self.message();
        }
    }

    /// The next message, with its topic.
    pub fn message(&mut self) -> Option<(String, Vec<u8>)> {
        match self.frame() {
            Frame::Message { channel, payload, .. } => {
                Some((self.topics[usize::from(channel)].clone(), payload))
            }
            Frame::Answer(answer) => {
                self.answer = Some(answer);
                None
            }
            Frame::Channels(_) => panic!("the channels came twice"),
        }
    }

    /// The first state of the robot that is as expected.
    pub fn wait_now(&mut self, what: &str, is_so: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        let mut last = Value::Null;
        while began.elapsed() < PATIENCE {
            let Some((topic, payload)) = self.message() else { continue };
            if topic == "/robot/now" {
                last = serde_json::from_slice(&payload).unwrap();
                if is_so(&last) {
                    return last;
                }
            }
        }
        panic!("{what} did not happen: {last}");
    }

    fn frame(&mut self) -> Frame {
        let mut piece = [0; 16384];
        loop {
            if let Some(frame) = self.reader.next_frame().unwrap() {
                return frame;
            }
            let count = self.stream.read(&mut piece).unwrap();
            assert!(count > 0, "the robot has closed the connection");
            self.reader.push(&piece[..count]);
        }
    }
}
