//! Who may connect, and as what.

use std::net::IpAddr;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use runtime::operator::Role;

/// The shortest token: 96 bits in base64.
const SHORTEST: usize = 16;
/// The longest name of a token's owner.
const LONGEST_NAME: usize = 40;

/// Options that the program does not accept.
#[derive(Debug)]
pub struct Refused(String);

impl Refused {
    pub(crate) fn of_file(path: &Path, why: &dyn std::fmt::Display) -> Self {
        Self(format!("{}: {why}", path.display()))
    }
}

impl std::fmt::Display for Refused {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Refused {}

/// Refuses a file with a secret that other users can read.
pub(crate) fn refuse_if_others_can_read(path: &Path) -> Result<(), Refused> {
    let name = path.display();
    let about = std::fs::metadata(path).map_err(|error| Refused(format!("{name}: {error}")))?;
    if about.permissions().mode() & 0o077 != 0 {
        return Err(Refused(format!("{name}: other users can read it: chmod 600 {name}")));
    }
    Ok(())
}

/// A client that may connect.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// The name of its token, if it has one.
    pub name: Option<String>,
    /// What it may do.
    pub role: Role,
}

/// The tokens of a file.
#[derive(Debug, Default)]
pub struct Tokens {
    tokens: Vec<(blake3::Hash, Identity)>,
}

impl Tokens {
    /// Reads a file that only its owner can read.
    ///
    /// # Errors
    /// A file that others can read, or with a line that is not a token.
    pub fn read(path: &Path) -> Result<Self, Refused> {
        refuse_if_others_can_read(path)?;
        let text = std::fs::read_to_string(path).map_err(|error| Refused::of_file(path, &error))?;
        Self::parse(&text).map_err(|why| Refused::of_file(path, &why))
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// The number and the fault of a line that is not a token. It never holds the token.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut tokens = Vec::new();
        for (at, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            tokens.push(parse_line(line).map_err(|why| format!("line {}: {why}", at + 1))?);
        }
        if tokens.is_empty() {
            return Err("there is no token: a line is NAME watch|steer TOKEN".to_owned());
        }
        Ok(Self { tokens })
    }

    /// The client of a token. It takes the same time whichever token it is.
    fn find(&self, token: &str) -> Option<&Identity> {
        let given = blake3::hash(token.as_bytes());
        let mut found = None;
        for (hash, identity) in &self.tokens {
            if *hash == given {
                found = Some(identity);
            }
        }
        found
    }
}

/// Reads the hash of a token and whose token it is.
fn parse_line(line: &str) -> Result<(blake3::Hash, Identity), &'static str> {
    let parts: Vec<&str> = line.split_whitespace().collect();
    let [name, role, token] = parts[..] else {
        return Err("a line is NAME watch|steer TOKEN");
    };
    let role = match role {
        "watch" => Role::Watch,
        "steer" => Role::Steer,
        _ => return Err("the role is neither `watch` nor `steer`"),
    };
    if name.len() > LONGEST_NAME {
        return Err("the name is longer than 40 bytes");
    }
    if token.len() < SHORTEST {
        return Err("the token is shorter than 16 characters; `openssl rand -hex 16` makes one");
    }
    let identity = Identity { name: Some(name.to_owned()), role };
    Ok((blake3::hash(token.as_bytes()), identity))
}

/// What protects the bytes between a client and this program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Transport {
    /// No encryption: only for clients on this computer.
    Plain,
    /// TLS of this program.
    Tls,
    /// Something else, such as a VPN or a TLS proxy, as the person who started the program says.
    ProtectedElsewhere,
}

/// The rules of access.
#[derive(Debug)]
pub struct Access {
    tokens: Option<Tokens>,
    origins: Vec<String>,
}

/// What a client says of itself before it is connected.
#[derive(Debug, Clone, Copy, Default)]
pub struct Handshake<'a> {
    pub token: Option<&'a str>,
    /// The page that connects, where a browser does.
    pub origin: Option<&'a str>,
    /// The server's name as the client wrote it.
    pub host: Option<&'a str>,
}

impl Access {
    /// The rules for a server at this address.
    ///
    /// # Errors
    /// An address that other computers can reach, without tokens or without protection on the way.
    pub fn new(
        address: IpAddr,
        transport: Transport,
        tokens: Option<Tokens>,
        origins: Vec<String>,
    ) -> Result<Self, Refused> {
        if !address.is_loopback() && tokens.is_none() {
            return Err(Refused(format!(
                "other computers could steer the robot at {address}: give --tokens FILE, or listen at 127.0.0.1 and \
                 connect by `ssh -L 8765:127.0.0.1:8765 ROBOT`"
            )));
        }
        if !address.is_loopback() && transport == Transport::Plain {
            return Err(Refused(format!(
                "at {address} others could read the tokens on their way: give --tls-certificate and --tls-key, or listen at \
                 127.0.0.1 and connect by ssh; --no-tls if a VPN or a proxy protects the connection"
            )));
        }
        Ok(Self { tokens, origins })
    }

    /// Whether every client needs a token.
    #[must_use]
    pub fn needs_token(&self) -> bool {
        self.tokens.is_some()
    }

    /// Says who a client is and what it may do.
    ///
    /// # Errors
    /// Why it may not connect.
    pub fn authorize(&self, client: Handshake<'_>) -> Result<Identity, &'static str> {
        // A token is not sent by a browser on its own, so the page that sends it was given it.
        if let Some(tokens) = &self.tokens {
            let found = client.token.and_then(|token| tokens.find(token));
            return found.cloned().ok_or("the token is missing or invalid");
        }
        // Without tokens, a page of the internet in a browser on this computer must not steer the robot: neither from its own
        // origin, nor by a name of its own that it lets point to this computer.
        if !client.host.is_some_and(is_loopback) {
            return Err("the address must be 127.0.0.1 or localhost");
        }
        let is_own = client.origin.is_none_or(|origin| {
            let name = origin.strip_prefix("http://").or(origin.strip_prefix("https://"));
            name.is_some_and(|name| Some(name) == client.host)
                || self.origins.iter().any(|allowed| allowed == origin)
        });
        if !is_own {
            return Err("pages of this origin may not connect; see --allow-origin");
        }
        Ok(Identity { name: None, role: Role::Steer })
    }
}

/// Whether a `Host` header names this computer by what no name server can change.
fn is_loopback(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    let name = name.trim_start_matches('[').trim_end_matches(']');
    name == "localhost" || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{Ipv4Addr, Ipv6Addr};

    const LOCAL: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
    const TOKENS: &str =
        "# tokens\n\nanna steer aaaaaaaaaaaaaaaa1\nscreen watch bbbbbbbbbbbbbbbb2\n";

    fn of_host(host: &str) -> Handshake<'_> {
        Handshake { host: Some(host), ..Handshake::default() }
    }

    fn with_token(token: Option<&str>) -> Handshake<'_> {
        Handshake { token, ..of_host("robot.local:8765") }
    }

    fn may_connect(access: &Access, origin: &str, host: &str) -> bool {
        access.authorize(Handshake { origin: Some(origin), ..of_host(host) }).is_ok()
    }

    fn tokens() -> Option<Tokens> {
        Some(Tokens::parse(TOKENS).unwrap())
    }

    fn access_at(
        address: &str,
        transport: Transport,
        tokens: Option<Tokens>,
    ) -> Result<Access, String> {
        let address: IpAddr = address.parse().unwrap();
        Access::new(address, transport, tokens, Vec::new()).map_err(|why| why.to_string())
    }

    #[test]
    fn another_address_than_loopback_needs_tokens_and_tls() {
        for address in ["0.0.0.0", "192.168.1.7", "::"] {
            assert!(access_at(address, Transport::Tls, None).unwrap_err().contains("--tokens"));
            assert!(
                access_at(address, Transport::Plain, tokens())
                    .unwrap_err()
                    .contains("--tls-certificate")
            );
            assert!(access_at(address, Transport::Tls, tokens()).is_ok());
            assert!(access_at(address, Transport::ProtectedElsewhere, tokens()).is_ok());
        }
        let local = Access::new(Ipv6Addr::LOCALHOST.into(), Transport::Plain, None, Vec::new());
        assert!(local.is_ok());
    }

    #[test]
    fn a_token_gives_its_role_and_nothing_else_does() {
        let access = Access::new(LOCAL, Transport::Plain, tokens(), Vec::new()).unwrap();
        let anna = Identity { name: Some("anna".to_owned()), role: Role::Steer };
        assert_eq!(access.authorize(with_token(Some("aaaaaaaaaaaaaaaa1"))), Ok(anna));
        let screen = access.authorize(with_token(Some("bbbbbbbbbbbbbbbb2"))).unwrap();
        assert_eq!(screen.role, Role::Watch);
        for wrong in [None, Some(""), Some("aaaaaaaaaaaaaaaa"), Some("anna")] {
            assert!(access.authorize(with_token(wrong)).is_err());
        }
        assert!(access.authorize(of_host("127.0.0.1:8765")).is_err());
    }

    #[test]
    fn a_page_of_the_internet_steers_nothing_on_this_computer() {
        let access =
            Access::new(LOCAL, Transport::Plain, None, vec!["https://app.foxglove.dev".to_owned()])
                .unwrap();
        assert!(may_connect(&access, "http://127.0.0.1:8765", "127.0.0.1:8765"));
        assert!(may_connect(&access, "http://localhost:8765", "localhost:8765"));
        assert!(may_connect(&access, "https://localhost:8765", "localhost:8765"));
        assert!(may_connect(&access, "https://app.foxglove.dev", "127.0.0.1:8765"));
        assert!(!may_connect(&access, "http://evil.example", "127.0.0.1:8765"));
        assert!(!may_connect(&access, "null", "127.0.0.1:8765"));
        assert!(!may_connect(&access, "http://127.0.0.1:9999", "127.0.0.1:8765"));
        // Its own name, which its name server lets point to this computer.
        assert!(!may_connect(&access, "http://evil.example:8765", "evil.example:8765"));
        assert!(!may_connect(&access, "http://127.0.0.1.evil.example", "127.0.0.1.evil.example"));
        assert!(access.authorize(of_host("[::1]:8765")).is_ok());
        assert!(access.authorize(Handshake::default()).is_err());
    }

    #[test]
    fn a_file_of_tokens_names_the_line_that_is_wrong_and_never_the_token() {
        for (text, part) in [
            ("anna steer", "line 1"),
            ("# x\nanna root aaaaaaaaaaaaaaaa1", "line 2"),
            ("anna steer short", "openssl"),
            ("", "no token"),
        ] {
            let error = Tokens::parse(text).unwrap_err();
            assert!(error.contains(part) && !error.contains("aaaa"), "{error}");
        }
    }

    #[test]
    fn a_file_that_others_can_read_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("tokens");
        std::fs::write(&path, TOKENS).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
        assert!(Tokens::read(&path).unwrap_err().to_string().contains("chmod 600"));
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        assert!(Tokens::read(&path).is_ok());
        assert!(Tokens::read(&dir.path().join("none")).is_err());
    }
}
