//! One client at the WebSocket.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use axum::body::Bytes;
use axum::extract::ws::{CloseFrame, Message, WebSocket, close_code};
use futures_util::stream::SplitSink;
use futures_util::{SinkExt, StreamExt};
use live_link::Channel;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio::time::{interval, timeout};

use crate::access::Identity;
use crate::protocol::{self, Call, ClientChannel, Request, Subscription};
use crate::publish;
use crate::robot::{Link, Listener, Robot};

/// Period of the pings to a client. Browsers and WebSocket libraries answer them on their own.
const PING_EVERY: Duration = Duration::from_secs(1);
/// A client that has sent nothing for this long, no answer to a ping either, is gone.
const SILENT_FOR: Duration = Duration::from_secs(4);
/// A client that takes nothing for this long is cut off.
const TAKES_WITHIN: Duration = Duration::from_secs(5);
/// Messages a second from a client, and in a burst; a client that sends more is cut off.
const MESSAGES_PER_S: f64 = 50.0;
const BURST: f64 = 200.0;
/// Answers and the like that wait for a client.
const ANSWERS: usize = 64;
/// Subscriptions and channels of one client.
const MOST_SUBSCRIPTIONS: usize = 256;

/// The connection with one client.
pub struct Session {
    robot: Robot,
    identity: Identity,
    /// Address and name, for the recording.
    who: String,
    listener: Arc<Listener>,
    answers: mpsc::Sender<Message>,
    published: Vec<ClientChannel>,
    allowance: Allowance,
}

impl Session {
    /// Serves a client until it leaves.
    pub async fn run(socket: WebSocket, robot: Robot, identity: Identity, address: String) {
        let who = match &identity.name {
            Some(name) => format!("{name} at {address}"),
            None => address,
        };
        let (listener, messages) = robot.join();
        let (answers, answers_to_send) = mpsc::channel(ANSWERS);
        let (sink, mut stream) = socket.split();
        let outgoing = Outgoing {
            sink,
            link: robot.link(),
            listener: Arc::clone(&listener),
            channels: Arc::default(),
            identity: identity.clone(),
        };
        let writer: JoinHandle<()> = tokio::spawn(outgoing.run(messages, answers_to_send));
        let allowance = Allowance::default();
        let mut session =
            Self { robot, identity, who, listener, answers, published: Vec::new(), allowance };
        while let Ok(Some(Ok(message))) = timeout(SILENT_FOR, stream.next()).await {
            if writer.is_finished() || matches!(message, Message::Close(_)) {
                break;
            }
            if let Err(error) = session.take(message).await {
                tracing::warn!("{}: {error:#}", session.who);
                break;
            }
        }
        session.robot.leave(&session.listener);
        let dropped = session.listener.dropped();
        tracing::info!("{} left; it was too slow for {dropped} messages", session.who);
        writer.abort();
    }

    async fn take(&mut self, message: Message) -> Result<()> {
        if !self.allowance.take() {
            let frame = CloseFrame { code: close_code::POLICY, reason: "too many messages".into() };
            let _ = self.answers.send(Message::Close(Some(frame))).await;
            bail!("it sent too many messages and was cut off");
        }
        let request = match &message {
            Message::Text(text) => protocol::read_text(text),
            Message::Binary(bytes) => protocol::read_binary(bytes),
            Message::Close(_) | Message::Ping(_) | Message::Pong(_) => Ok(Request::Other),
        };
        match request {
            Ok(request) => self.request(request).await,
            Err(why) => self.say(protocol::warning(&why)).await,
        }
    }

    async fn request(&mut self, request: Request) -> Result<()> {
        match request {
            Request::Subscribe(new) => {
                self.robot.subscribe(&self.listener, |list| subscribe(list, &new));
            }
            Request::Unsubscribe(ids) => {
                self.robot
                    .subscribe(&self.listener, |list| list.retain(|(_, id)| !ids.contains(id)));
            }
            Request::Advertise(channels) => {
                let free = MOST_SUBSCRIPTIONS.saturating_sub(self.published.len());
                self.published.extend(channels.into_iter().take(free));
            }
            Request::Unadvertise(ids) => {
                self.published.retain(|channel| !ids.contains(&channel.id));
            }
            Request::Publish { channel, payload } => return self.publish(channel, &payload).await,
            Request::Call(call) => return self.call(call).await,
            Request::Other => {}
        }
        Ok(())
    }

    async fn publish(&self, channel: u32, payload: &[u8]) -> Result<()> {
        let channel = self.published.iter().find(|known| known.id == channel);
        let Some(channel) = channel.filter(|channel| channel.encoding == "json") else {
            return self.say(protocol::warning("only channels in JSON can be published")).await;
        };
        let topic = channel.topic.clone();
        let order = match publish::order(payload) {
            Ok(order) => order,
            Err(why) => return self.say(protocol::warning(&format!("{topic}: {why}"))).await,
        };
        let answer = self.robot.order(&self.who, self.identity.role, order).await;
        match answer {
            Ok(answer) if answer.accepted => Ok(()),
            Ok(answer) => self.say(protocol::warning(&answer.text)).await,
            Err(why) => self.say(protocol::warning(&why)).await,
        }
    }

    /// Passes a call on. The answer comes later: a stop must not wait for the answer of an order before it.
    async fn call(&self, call: Call) -> Result<()> {
        let order = match protocol::order_of(&call) {
            Ok(order) => order,
            Err(why) => return self.say(protocol::service_failure(&call, &why)).await,
        };
        let robot = self.robot.clone();
        let who = self.who.clone();
        let role = self.identity.role;
        let answers = self.answers.clone();
        tokio::spawn(async move {
            let message = match robot.order(&who, role, order).await {
                Ok(answer) => Message::Binary(
                    protocol::service_response(&call, answer.accepted, &answer.text).into(),
                ),
                Err(why) => Message::Text(protocol::service_failure(&call, &why).into()),
            };
            let _ = answers.send(message).await;
        });
        Ok(())
    }

    async fn say(&self, text: String) -> Result<()> {
        self.answers.send(Message::Text(text.into())).await.context("the client has left")
    }
}

fn subscribe(list: &mut Vec<(u16, u32)>, new: &[Subscription]) {
    for subscription in new {
        let Ok(channel) = u16::try_from(subscription.channel) else { continue };
        if list.len() < MOST_SUBSCRIPTIONS && !list.iter().any(|(_, id)| *id == subscription.id) {
            list.push((channel, subscription.id));
        }
    }
}

/// The writing side of a client.
struct Outgoing {
    sink: SplitSink<WebSocket, Message>,
    link: watch::Receiver<Link>,
    listener: Arc<Listener>,
    /// The channels that the client knows.
    channels: Arc<Vec<Channel>>,
    identity: Identity,
}

impl Outgoing {
    async fn run(mut self, messages: mpsc::Receiver<Vec<u8>>, answers: mpsc::Receiver<Message>) {
        let ended = self.serve(messages, answers).await;
        if let Err(error) = ended {
            tracing::debug!("a client was cut off: {error:#}");
        }
        let _ = self.sink.close().await;
    }

    async fn serve(
        &mut self,
        mut messages: mpsc::Receiver<Vec<u8>>,
        mut answers: mpsc::Receiver<Message>,
    ) -> Result<()> {
        let session = format!("{}", std::process::id());
        self.text(protocol::server_info(self.identity.role, &session)).await?;
        self.text(protocol::advertise_services(self.identity.role)).await?;
        self.show_link().await?;
        let mut pings = interval(PING_EVERY);
        loop {
            tokio::select! {
                // Answers go before what is shown.
                biased;
                answer = answers.recv() => self.send(answer.context("the session has ended")?).await?,
                changed = self.link.changed() => {
                    changed?;
                    self.show_link().await?;
                }
                _ = pings.tick() => self.send(Message::Ping(Bytes::new())).await?,
                message = messages.recv() => {
                    let message = message.context("the session has ended")?;
                    self.listener.taken(&message);
                    self.send(Message::Binary(message.into())).await?;
                }
            }
        }
    }

    /// Says whether the robot is there, and which channels it has.
    async fn show_link(&mut self) -> Result<()> {
        let link = self.link.borrow_and_update().clone();
        if link.channels != self.channels {
            if !self.channels.is_empty() {
                self.text(protocol::unadvertise(&self.channels)).await?;
            }
            self.text(protocol::advertise(&link.channels)).await?;
            self.channels = link.channels;
        }
        self.text(protocol::robot_status(link.lost.as_deref())).await
    }

    async fn text(&mut self, text: String) -> Result<()> {
        self.send(Message::Text(text.into())).await
    }

    async fn send(&mut self, message: Message) -> Result<()> {
        timeout(TAKES_WITHIN, self.sink.send(message))
            .await
            .context("it takes nothing any more")??;
        Ok(())
    }
}

/// Counts a client's messages.
struct Allowance {
    left: f64,
    then: Instant,
}

impl Default for Allowance {
    fn default() -> Self {
        Self { left: BURST, then: Instant::now() }
    }
}

impl Allowance {
    fn take(&mut self) -> bool {
        let now = Instant::now();
        let since_s = now.duration_since(self.then).as_secs_f64();
        self.then = now;
        self.left = (self.left + since_s * MESSAGES_PER_S).min(BURST) - 1.0;
        self.left >= 0.0
    }
}
