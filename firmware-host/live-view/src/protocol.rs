//! Foxglove's WebSocket protocol (`foxglove.sdk.v1`), as far as a robot needs it.
//!
//! JSON in text messages; messages of channels and calls of services in binary ones, with numbers in little-endian:
//!
//! | first byte | from | content |
//! |---|---|---|
//! | 1 | server | subscription (4), time (8), message |
//! | 3 | server | service (4), call (4), length of the encoding's name (4), the name, response |
//! | 1 | client | channel of the client (4), message |
//! | 2 | client | service (4), call (4), length of the encoding's name (4), the name, request |

use live_link::{Channel, Order};
use runtime::exploration::PolicyKind;
use runtime::operator::Role;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The supported subprotocols, the preferred one first. The older name has the same messages.
pub const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

const MESSAGE_DATA: u8 = 1;
const SERVICE_REQUEST: u8 = 2;
const SERVICE_RESPONSE: u8 = 3;

/// The number of the status that says that the robot is not there.
const ROBOT_STATUS: &str = "robot";

/// A client's message that matters here.
#[derive(Debug, Clone, PartialEq)]
pub enum Request {
    /// Subscriptions with their channels.
    Subscribe(Vec<Subscription>),
    /// Subscriptions that end.
    Unsubscribe(Vec<u32>),
    /// Channels on which the client will publish.
    Advertise(Vec<ClientChannel>),
    /// Channels that end.
    Unadvertise(Vec<u32>),
    /// A message on a channel of the client.
    Publish {
        /// The client's channel.
        channel: u32,
        payload: Vec<u8>,
    },
    /// A call of a service.
    Call(Call),
    /// A message of the protocol that changes nothing here.
    Other,
}

/// A client's subscription to a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub struct Subscription {
    /// Chosen by the client.
    pub id: u32,
    /// The robot's channel.
    #[serde(rename = "channelId")]
    pub channel: u32,
}

/// A channel of a client.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct ClientChannel {
    /// Chosen by the client.
    pub id: u32,
    /// Such as `/goal_pose`.
    pub topic: String,
    /// Such as `json`.
    pub encoding: String,
}

/// A call of a service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Call {
    /// Number of the service.
    pub service: u32,
    /// Chosen by the client; the response has it too.
    pub id: u32,
    /// Body of the request.
    pub payload: Vec<u8>,
}

#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Text {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    Advertise {
        channels: Vec<ClientChannel>,
    },
    #[serde(rename_all = "camelCase")]
    Unadvertise {
        channel_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

/// Reads a text message.
///
/// # Errors
/// What is not one of the protocol, in words.
pub fn read_text(text: &str) -> Result<Request, String> {
    let text: Text =
        serde_json::from_str(text).map_err(|error| format!("not Foxglove's protocol: {error}"))?;
    Ok(match text {
        Text::Subscribe { subscriptions } => Request::Subscribe(subscriptions),
        Text::Unsubscribe { subscription_ids } => Request::Unsubscribe(subscription_ids),
        Text::Advertise { channels } => Request::Advertise(channels),
        Text::Unadvertise { channel_ids } => Request::Unadvertise(channel_ids),
        Text::Other => Request::Other,
    })
}

/// Reads a binary message.
///
/// # Errors
/// What is not one of the protocol, in words.
pub fn read_binary(bytes: &[u8]) -> Result<Request, String> {
    let (kind, rest) = bytes.split_first().ok_or_else(cut_off)?;
    match *kind {
        MESSAGE_DATA => {
            let (channel, payload) = take_u32(rest).ok_or_else(cut_off)?;
            Ok(Request::Publish { channel, payload: payload.to_vec() })
        }
        SERVICE_REQUEST => {
            let (service, rest) = take_u32(rest).ok_or_else(cut_off)?;
            let (id, rest) = take_u32(rest).ok_or_else(cut_off)?;
            let (length, rest) = take_u32(rest).ok_or_else(cut_off)?;
            let payload = rest.get(length as usize..).ok_or_else(cut_off)?;
            Ok(Request::Call(Call { service, id, payload: payload.to_vec() }))
        }
        _ => Ok(Request::Other),
    }
}

fn cut_off() -> String {
    "a binary message is cut off".to_owned()
}

fn take_u32(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (number, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(*number), rest))
}

/// A message of a channel.
#[must_use]
pub fn message_data(subscription: u32, time_ns: u64, payload: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(13 + payload.len());
    bytes.push(MESSAGE_DATA);
    bytes.extend_from_slice(&subscription.to_le_bytes());
    bytes.extend_from_slice(&time_ns.to_le_bytes());
    bytes.extend_from_slice(payload);
    bytes
}

/// The response to a call.
#[must_use]
pub fn service_response(call: &Call, accepted: bool, text: &str) -> Vec<u8> {
    let response = json!({"accepted": accepted, "text": text}).to_string();
    let mut bytes = vec![SERVICE_RESPONSE];
    bytes.extend_from_slice(&call.service.to_le_bytes());
    bytes.extend_from_slice(&call.id.to_le_bytes());
    bytes.extend_from_slice(&(ENCODING.len() as u32).to_le_bytes());
    bytes.extend_from_slice(ENCODING.as_bytes());
    bytes.extend_from_slice(response.as_bytes());
    bytes
}

/// A call that could not be carried out at all.
#[must_use]
pub fn service_failure(call: &Call, message: &str) -> String {
    let (service, id) = (call.service, call.id);
    json!({"op": "serviceCallFailure", "serviceId": service, "callId": id, "message": message})
        .to_string()
}

const ENCODING: &str = "json";

/// The first message to a client. It tells the client its role.
#[must_use]
pub fn server_info(role: Role, session: &str) -> String {
    let capabilities: &[&str] = match role {
        Role::Watch => &["services"],
        Role::Steer => &["services", "clientPublish"],
    };
    json!({
        "op": "serverInfo",
        "name": "Embodied Depth",
        "capabilities": capabilities,
        "supportedEncodings": [ENCODING],
        "metadata": {"role": role.name(), "version": env!("CARGO_PKG_VERSION")},
        "sessionId": session,
    })
    .to_string()
}

/// The robot's channels.
#[must_use]
pub fn advertise(channels: &[Channel]) -> String {
    #[derive(Serialize)]
    #[serde(rename_all = "camelCase")]
    struct Advertised<'a> {
        id: u32,
        topic: &'a str,
        encoding: &'a str,
        schema_name: &'a str,
        schema: &'a str,
        schema_encoding: &'a str,
    }
    let channels: Vec<_> = channels
        .iter()
        .map(|channel| Advertised {
            id: u32::from(channel.id),
            topic: &channel.topic,
            encoding: &channel.encoding,
            schema_name: &channel.schema_name,
            schema: &channel.schema,
            schema_encoding: &channel.schema_encoding,
        })
        .collect();
    json!({"op": "advertise", "channels": channels}).to_string()
}

/// Channels that are gone.
#[must_use]
pub fn unadvertise(channels: &[Channel]) -> String {
    let ids: Vec<u16> = channels.iter().map(|channel| channel.id).collect();
    json!({"op": "unadvertise", "channelIds": ids}).to_string()
}

/// Whether the robot is there: a status that stays until the robot is back.
#[must_use]
pub fn robot_status(lost: Option<&str>) -> String {
    const ERROR: u8 = 2;
    match lost {
        Some(message) => {
            json!({"op": "status", "level": ERROR, "message": message, "id": ROBOT_STATUS})
                .to_string()
        }
        None => json!({"op": "removeStatus", "statusIds": [ROBOT_STATUS]}).to_string(),
    }
}

/// A warning that concerns one message of the client.
#[must_use]
pub fn warning(message: &str) -> String {
    const WARNING: u8 = 1;
    json!({"op": "status", "level": WARNING, "message": message}).to_string()
}

/// The services of a role. Their numbers are the places in [`Order::ALL`], from 1.
#[must_use]
pub fn advertise_services(role: Role) -> String {
    let services: Vec<_> = Order::ALL
        .iter()
        .enumerate()
        .filter(|(_, order)| order.is_allowed_to(role))
        .map(|(at, order)| service(at + 1, *order))
        .collect();
    json!({"op": "advertiseServices", "services": services}).to_string()
}

fn service(number: usize, order: Order) -> Value {
    let name = service_name(order);
    let request = match order {
        Order::GoTo { .. } => json!({
            "type": "object", "required": ["x_m", "y_m"],
            "properties": {"x_m": {"type": "number"}, "y_m": {"type": "number"}},
        }),
        Order::Drive { .. } => json!({
            "type": "object", "required": ["linear_mps", "angular_radps"],
            "properties": {"linear_mps": {"type": "number"}, "angular_radps": {"type": "number"}},
        }),
        Order::ExploreBy { .. } => json!({
            "type": "object", "required": ["policy"],
            "properties": {"policy": {"enum": PolicyKind::ALL.map(PolicyKind::name)}},
        }),
        Order::KeepOut { .. } => json!({
            "type": "object", "required": ["corners_m"],
            "properties": {"corners_m": {
                "type": "array", "minItems": 4, "maxItems": 4,
                "items": {"type": "array", "minItems": 2, "maxItems": 2, "items": {"type": "number"}},
            }},
        }),
        _ => json!({"type": "object", "properties": {}}),
    };
    let response = json!({
        "type": "object",
        "properties": {"accepted": {"type": "boolean"}, "text": {"type": "string"}},
    });
    json!({
        "id": number,
        "name": format!("/robot/{name}"),
        "type": format!("robot.{name}"),
        "request": described(name, "request", &request),
        "response": described(name, "response", &response),
    })
}

fn described(name: &str, suffix: &str, schema: &Value) -> Value {
    json!({
        "encoding": ENCODING,
        "schemaName": format!("robot.{name}.{suffix}"),
        "schemaEncoding": "jsonschema",
        "schema": schema.to_string(),
    })
}

/// The last part of a service's name.
pub(crate) fn service_name(order: Order) -> &'static str {
    match order {
        Order::Stop => "stop",
        Order::Disarm => "disarm",
        Order::Arm => "arm",
        Order::Pause => "pause",
        Order::Resume => "resume",
        Order::GoTo { .. } => "go_to",
        Order::Return => "return",
        Order::SaveMap => "save_map",
        Order::Drive { .. } => "drive",
        Order::KeepOut { .. } => "keep_out",
        Order::OpenAreas => "open_areas",
        Order::ExploreBy { .. } => "explore_by",
    }
}

/// The order that a call is.
///
/// # Errors
/// A number that no service has, or a request without the numbers that the order needs.
pub fn order_of(call: &Call) -> Result<Order, String> {
    #[derive(Deserialize)]
    struct Place {
        x_m: f64,
        y_m: f64,
    }
    #[derive(Deserialize)]
    struct Velocity {
        linear_mps: f64,
        angular_radps: f64,
    }
    #[derive(Deserialize)]
    struct Policy {
        policy: PolicyKind,
    }
    #[derive(Deserialize)]
    struct Area {
        corners_m: [[f64; 2]; 4],
    }
    let at = (call.service as usize).checked_sub(1);
    let order = at.and_then(|at| Order::ALL.get(at)).ok_or("there is no such service")?;
    match order {
        Order::GoTo { .. } => {
            let place: Place = serde_json::from_slice(&call.payload)
                .map_err(|error| format!("a place is {{\"x_m\": 1.0, \"y_m\": 2.0}}: {error}"))?;
            Ok(Order::GoTo { x_m: place.x_m, y_m: place.y_m })
        }
        Order::Drive { .. } => {
            let velocity: Velocity = serde_json::from_slice(&call.payload).map_err(|error| {
                format!("a velocity is {{\"linear_mps\": 0.1, \"angular_radps\": 0.0}}: {error}")
            })?;
            let Velocity { linear_mps, angular_radps } = velocity;
            Ok(Order::Drive { linear_mps, angular_radps })
        }
        Order::ExploreBy { .. } => {
            let by: Policy = serde_json::from_slice(&call.payload)
                .map_err(|error| format!("a policy is {{\"policy\": \"active\"}}: {error}"))?;
            Ok(Order::ExploreBy { policy: by.policy })
        }
        Order::KeepOut { .. } => {
            let area: Area = serde_json::from_slice(&call.payload).map_err(|error| {
                format!("an area is {{\"corners_m\": [[0, 0], [1, 0], [1, 1], [0, 1]]}}: {error}")
            })?;
            Ok(Order::KeepOut { corners_m: area.corners_m })
        }
        order => Ok(*order),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn call(service: u32, payload: &str) -> Call {
        Call { service, id: 9, payload: payload.as_bytes().to_vec() }
    }

    #[test]
    fn a_call_is_read_and_its_response_has_its_numbers() {
        let mut bytes = vec![2, 6, 0, 0, 0, 9, 0, 0, 0, 4, 0, 0, 0];
        bytes.extend_from_slice(b"json{\"x_m\":1,\"y_m\":-2.5}");
        let Ok(Request::Call(read)) = read_binary(&bytes) else { panic!() };
        assert_eq!(read, call(6, "{\"x_m\":1,\"y_m\":-2.5}"));
        assert_eq!(order_of(&read), Ok(Order::GoTo { x_m: 1.0, y_m: -2.5 }));
        let response = service_response(&read, true, "ok");
        assert_eq!(response[..13], [3, 6, 0, 0, 0, 9, 0, 0, 0, 4, 0, 0, 0]);
        assert_eq!(&response[13..17], b"json");
    }

    #[test]
    fn cut_and_unknown_messages_are_no_calls() {
        let whole = [2, 6, 0, 0, 0, 9, 0, 0, 0, 4, 0, 0, 0, b'j', b's', b'o'];
        for length in 0..whole.len() {
            assert!(read_binary(&whole[..length]).is_err(), "{length}");
        }
        assert_eq!(read_binary(&[200, 1]), Ok(Request::Other));
        assert!(read_text("{").is_err() && read_text("{\"op\":\"subscribe\"}").is_err());
        assert_eq!(read_text(r#"{"op":"getParameters","parameterNames":[]}"#), Ok(Request::Other));
    }

    #[test]
    fn every_service_is_the_order_that_its_name_says() {
        for (at, order) in Order::ALL.into_iter().enumerate() {
            let request = r#"{"x_m":0,"y_m":0,"linear_mps":0,"angular_radps":0,"corners_m":[[0,0],[0,0],[0,0],[0,0]],"policy":"frontier"}"#;
            let read = order_of(&call(at as u32 + 1, request)).unwrap();
            assert_eq!(service_name(read), service_name(order));
        }
        assert!(order_of(&call(0, "{}")).is_err() && order_of(&call(99, "{}")).is_err());
        for with_numbers in [6, 9, 10, 12] {
            assert!(order_of(&call(with_numbers, "{}")).is_err(), "{with_numbers}");
        }
    }

    #[test]
    fn a_watcher_sees_the_service_that_stops_the_robot_only() {
        assert_eq!(
            (count_of_services(Role::Watch), count_of_services(Role::Steer)),
            (1, Order::ALL.len())
        );
    }

    fn count_of_services(role: Role) -> usize {
        let value: Value = serde_json::from_str(&advertise_services(role)).unwrap();
        value["services"].as_array().unwrap().len()
    }

    #[test]
    fn subscriptions_are_read_as_foxglove_writes_them() {
        let text = r#"{"op":"subscribe","subscriptions":[{"id":3,"channelId":5}]}"#;
        let expected = Request::Subscribe(vec![Subscription { id: 3, channel: 5 }]);
        assert_eq!(read_text(text), Ok(expected));
        let text = r#"{"op":"unsubscribe","subscriptionIds":[3]}"#;
        assert_eq!(read_text(text), Ok(Request::Unsubscribe(vec![3])));
    }
}
