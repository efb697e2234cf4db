//! The page and the WebSocket at one address.

use std::net::SocketAddr;
use std::sync::Arc;

use anyhow::{Context, Result};
use axum::Router;
use axum::body::Body;
use axum::extract::connect_info::Connected;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{ConnectInfo, Query, Request, State};
use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::serve::{IncomingStream, Listener};
use serde::Deserialize;
use tokio::net::TcpListener;

use crate::access::{Access, Handshake};
use crate::page;
use crate::protocol::SUBPROTOCOLS;
use crate::robot::Robot;
use crate::session::Session;
use crate::tls::TlsListener;

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

/// A client's address.
#[derive(Debug, Clone, Copy)]
pub struct Client(SocketAddr);

impl Connected<IncomingStream<'_, TcpListener>> for Client {
    fn connect_info(stream: IncomingStream<'_, TcpListener>) -> Self {
        Self(*stream.remote_addr())
    }
}

impl Connected<IncomingStream<'_, TlsListener>> for Client {
    fn connect_info(stream: IncomingStream<'_, TlsListener>) -> Self {
        Self(*stream.remote_addr())
    }
}

/// Serves until an error of the system.
///
/// # Errors
/// When the system takes the listener away.
pub async fn serve<L>(listener: L, robot: Robot, access: Access) -> Result<()>
where
    L: Listener<Addr = SocketAddr>,
    Client: for<'a> Connected<IncomingStream<'a, L>>,
{
    let state = ServerState { robot, access: Arc::new(access) };
    let routes = Router::new()
        .route("/", get(enter))
        .route("/{file}", get(page::file))
        .layer(from_fn_with_state(state.clone(), guard))
        .with_state(state);
    let service = routes.into_make_service_with_connect_info::<Client>();
    axum::serve(listener, service).await.context("the server has ended")
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
    ConnectInfo(Client(address)): ConnectInfo<Client>,
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
        let why = format!("the subprotocol {} is spoken here\n", SUBPROTOCOLS[0]);
        return (StatusCode::BAD_REQUEST, why).into_response();
    }
    upgrade
        .on_upgrade(move |socket| Session::run(socket, state.robot, identity, address.to_string()))
}

fn text<'a>(headers: &'a HeaderMap, name: &axum::http::HeaderName) -> Option<&'a str> {
    headers.get(name)?.to_str().ok()
}
