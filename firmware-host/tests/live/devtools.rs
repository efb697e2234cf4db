//! Chromium without a window, driven by its DevTools protocol: JSON over a WebSocket.

use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use futures_util::{SinkExt, StreamExt};
use rustix::process::{Pid, Signal, kill_process_group};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async_with_config};

use super::explore::PATIENCE;

/// The names under which Debian and others install it.
const PROGRAMS: [&str; 4] =
    ["chromium-headless-shell", "chromium", "chromium-browser", "google-chrome"];

/// A browser with one page.
pub struct Browser {
    child: Child,
    _profile: tempfile::TempDir,
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    session: Option<String>,
    next_id: u64,
}

/// The program's name. Tests that call this are ignored; `cargo xtask test` runs them where there is a browser.
fn program() -> &'static str {
    let Some(found) = PROGRAMS.into_iter().find(|program| runs(program)) else {
        panic!("chromium is missing: `apt-get install chromium-headless-shell`")
    };
    found
}

fn runs(program: &str) -> bool {
    Command::new(program).arg("--version").output().is_ok_and(|output| output.status.success())
}

impl Browser {
    pub async fn start() -> Self {
        let profile = tempfile::tempdir().unwrap();
        let mut child = Command::new(program())
            // Without a sandbox, because tests run as root in containers. Only our own page is opened.
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0"])
            .args(["--disable-dev-shm-usage", "--hide-scrollbars", "--force-color-profile=srgb"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stderr(Stdio::piped())
            .stdout(Stdio::null())
            .process_group(0)
            .spawn()
            .unwrap();
        let said = BufReader::new(child.stderr.take().unwrap());
        let mut lines = said.lines().map_while(Result::ok);
        let line = lines.find(|line| line.contains("DevTools listening on")).unwrap();
        let address = line.split_whitespace().last().unwrap().to_owned();
        // What it says later must not fill the pipe.
        std::thread::spawn(move || lines.for_each(drop));
        let config = WebSocketConfig::default().max_frame_size(None).max_message_size(None);
        let (socket, _) = connect_async_with_config(address, Some(config), false).await.unwrap();
        let mut browser = Self { child, _profile: profile, socket, session: None, next_id: 0 };
        let made = browser.call("Target.createTarget", json!({"url": "about:blank"})).await;
        let target = json!({"targetId": made["targetId"], "flatten": true});
        let attached = browser.call("Target.attachToTarget", target).await;
        browser.session = attached["sessionId"].as_str().map(ToOwned::to_owned);
        browser.call("Page.enable", json!({})).await;
        browser
    }

    pub async fn open(&mut self, url: &str) {
        self.call("Page.navigate", json!({"url": url})).await;
    }

    /// The size of a laptop's or a phone's window.
    pub async fn resize(&mut self, width: u32, height: u32, scale: f64) {
        let size = json!({"width": width, "height": height, "deviceScaleFactor": scale, "mobile": width < 800});
        self.call("Emulation.setDeviceMetricsOverride", size).await;
    }

    /// The value of an expression in the page. It may be a promise.
    pub async fn value(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let result = self.call("Runtime.evaluate", params).await;
        assert!(result.get("exceptionDetails").is_none(), "{expression}: {result}");
        result["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub async fn wait(&mut self, what: &str, expression: &str) {
        let began = Instant::now();
        while self.value(expression).await != true {
            let page = "document.body.innerText";
            assert!(began.elapsed() < PATIENCE, "{what}: {}", self.value(page).await);
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// Presses a mouse button in the middle of an element, as a person does.
    pub async fn click(&mut self, selector: &str) {
        let middle = format!(
            "(() => {{ const box = document.querySelector('{selector}').getBoundingClientRect();
             return [box.x + box.width / 2, box.y + box.height / 2]; }})()"
        );
        let middle = self.value(&middle).await;
        self.mouse(&middle[0], &middle[1]).await;
    }

    /// Presses a mouse button at a place in the window, pixels.
    pub async fn click_at(&mut self, x: u32, y: u32) {
        self.mouse(&json!(x), &json!(y)).await;
    }

    async fn mouse(&mut self, x: &Value, y: &Value) {
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({"type": kind, "x": x, "y": y, "button": "left", "clickCount": 1});
            self.call("Input.dispatchMouseEvent", event).await;
        }
    }

    /// Chooses an entry of a list.
    pub async fn choose(&mut self, selector: &str, value: &str) {
        let choose = format!(
            "(() => {{ const list = document.querySelector('{selector}'); list.value = '{value}';
             list.dispatchEvent(new Event('change')); return true; }})()"
        );
        self.value(&choose).await;
    }

    pub async fn press_key(&mut self, key: &str) {
        self.key("keyDown", key).await;
        self.key("keyUp", key).await;
    }

    /// `keyDown` or `keyUp`.
    pub async fn key(&mut self, kind: &str, key: &str) {
        self.call("Input.dispatchKeyEvent", json!({"type": kind, "key": key})).await;
    }

    pub async fn screenshot(&mut self, path: &Path) {
        let shot = self.call("Page.captureScreenshot", json!({"format": "png"})).await;
        let png = STANDARD.decode(shot["data"].as_str().unwrap()).unwrap();
        std::fs::write(path, png).unwrap();
    }

    async fn call(&mut self, method: &str, params: Value) -> Value {
        self.next_id += 1;
        let id = self.next_id;
        let mut request = json!({"id": id, "method": method, "params": params});
        if let Some(session) = &self.session {
            request["sessionId"] = json!(session);
        }
        self.socket.send(Message::Text(request.to_string().into())).await.unwrap();
        loop {
            let message = self.socket.next().await.unwrap().unwrap();
            let Message::Text(text) = message else { continue };
            let answer: Value = serde_json::from_str(&text).unwrap();
            if answer["id"] == id {
                assert!(answer.get("error").is_none(), "{method}: {answer}");
                return answer["result"].clone();
            }
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Its helper processes go on for ever if only the first one is killed.
        let group = Pid::from_raw(self.child.id() as i32).unwrap();
        let _ = kill_process_group(group, Signal::KILL);
        let _ = self.child.wait();
    }
}
