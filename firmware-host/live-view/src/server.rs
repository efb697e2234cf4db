//! The page and the WebSocket at one address.

use std::net::SocketAddr;
use std::sync::Arc;

use anyhow::{Context, Result};
use axum::Router;
use axum::body::Body;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{ConnectInfo, Query, Request, State};
use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::serve::{Listener, ListenerExt, TapIo};
use serde::Deserialize;
use tokio::net::TcpStream;
use tokio_rustls::server::TlsStream;

use crate::access::{Access, Handshake};
use crate::page;
use crate::protocol::SUBPROTOCOLS;
use crate::robot::Robot;
use crate::session::Session;

/// The largest message of a client: an order needs 100 bytes, subscriptions of Foxglove some kilobytes.
const MOST_BYTES: usize = 64 << 10;
/// Most clients at a time.
const MOST_CLIENTS: usize = 32;

#[derive(Clone)]
struct ServerState {
    robot: Robot,
    access: Arc<Access>,
}

#[derive(Deserialize)]
struct TokenQuery {
    token: Option<String>,
}

/// A connection over TCP.
pub trait Connection {
    /// The TCP stream below it.
    fn tcp(&self) -> &TcpStream;
}

impl Connection for TcpStream {
    fn tcp(&self) -> &TcpStream {
        self
    }
}

impl Connection for TlsStream<TcpStream> {
    fn tcp(&self) -> &TcpStream {
        self.get_ref().0
    }
}

/// Lets short messages of all connections go at once. Otherwise Nagle's algorithm keeps the answer to a stop back until the client
/// has acknowledged the image before it, which Linux delays by 40 ms.
fn sending_at_once<L>(listener: L) -> TapIo<L, impl FnMut(&mut L::Io)>
where
    L: Listener,
    L::Io: Connection,
{
    listener.tap_io(|connection| {
        if let Err(error) = connection.tcp().set_nodelay(true) {
            tracing::debug!("answers to a client may be late, TCP_NODELAY: {error}");
        }
    })
}

/// Serves until an error of the system.
///
/// # Errors
/// When the system takes the listener away.
pub async fn serve<L>(listener: L, robot: Robot, access: Access) -> Result<()>
where
    L: Listener<Addr = SocketAddr>,
    L::Io: Connection,
{
    let state = ServerState { robot, access: Arc::new(access) };
    let routes = Router::new()
        .route("/", get(enter))
        .route("/{file}", get(page::file))
        .layer(from_fn_with_state(state.clone(), guard))
        .with_state(state);
    let service = routes.into_make_service_with_connect_info::<SocketAddr>();
    axum::serve(sending_at_once(listener), service).await.context("the server has ended")
}

/// Without tokens, a name that is not this computer's gets nothing at all.
async fn guard(State(state): State<ServerState>, request: Request<Body>, next: Next) -> Response {
    let host = text(request.headers(), &HOST);
    if !state.access.needs_token()
        && state.access.authorize(Handshake { host, ..Handshake::default() }).is_err()
    {
        return (StatusCode::FORBIDDEN, "the address must be 127.0.0.1 or localhost\n")
            .into_response();
    }
    page::with_headers(next.run(request).await)
}

/// The page, or the WebSocket if the client asks for it. Foxglove connects to the root.
async fn enter(
    State(state): State<ServerState>,
    ConnectInfo(address): ConnectInfo<SocketAddr>,
    Query(query): Query<TokenQuery>,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let Ok(upgrade) = upgrade else { return page::index() };
    let client = Handshake {
        token: query.token.as_deref(),
        origin: text(&headers, &ORIGIN),
        host: text(&headers, &HOST),
    };
    let identity = match state.access.authorize(client) {
        Ok(identity) => identity,
        Err(why) => {
            tracing::warn!("{address} was refused: {why}");
            let code = if state.access.needs_token() {
                StatusCode::UNAUTHORIZED
            } else {
                StatusCode::FORBIDDEN
            };
            return (code, format!("{why}\n")).into_response();
        }
    };
    if state.robot.listeners() >= MOST_CLIENTS {
        return (StatusCode::SERVICE_UNAVAILABLE, "there are too many clients\n").into_response();
    }
    let upgrade =
        upgrade.protocols(SUBPROTOCOLS).max_message_size(MOST_BYTES).max_frame_size(MOST_BYTES);
    if upgrade.selected_protocol().is_none() {
        let why = format!("use the subprotocol {}\n", SUBPROTOCOLS[0]);
        return (StatusCode::BAD_REQUEST, why).into_response();
    }
    upgrade
        .on_upgrade(move |socket| Session::run(socket, state.robot, identity, address.to_string()))
}

fn text<'a>(headers: &'a HeaderMap, name: &axum::http::HeaderName) -> Option<&'a str> {
    headers.get(name)?.to_str().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::net::TcpListener;

    #[tokio::test]
    async fn connections_send_short_messages_at_once() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let _client = TcpStream::connect(address).await.unwrap();
        let (connection, _) = Listener::accept(&mut sending_at_once(listener)).await;
        assert!(connection.nodelay().unwrap());
    }
}
