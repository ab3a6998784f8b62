//! `cargo xtask serve --lan`: the page for a phone on the same network. Browsers give a camera to secure pages only, so it is
//! served by TLS with a certificate made here; the phone asks once whether to trust it.

use crate::paths;
use anyhow::{Context as _, Result, bail};
use qrcode::QrCode;
use qrcode::render::unicode::Dense1x2;
use rcgen::{CertifiedKey, generate_simple_self_signed};
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use rustls::{ServerConfig, ServerConnection, StreamOwned};
use std::fs;
use std::io::{Read, Write};
use std::net::{IpAddr, Ipv4Addr, TcpStream, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// What makes a server reachable from the network.
#[derive(Debug, Clone)]
pub(super) struct Lan {
    /// This machine in the network.
    pub(super) address: IpAddr,
    pub(super) tls: Arc<ServerConfig>,
}

impl Lan {
    /// With this machine's address, or the given one.
    ///
    /// # Errors
    ///
    /// When there is no network, or no certificate can be made.
    pub(super) fn new(address: Option<IpAddr>) -> Result<Self> {
        let address = match address {
            Some(address) => address,
            None => own_address()?,
        };
        let (certificate, key) = certificate(address, &paths::target().join("lan"))?;
        Ok(Self {
            address,
            tls: config(certificate, key)?,
        })
    }
}

/// The address that this machine has where it would send to other networks. Nothing is sent: connecting a datagram socket
/// only chooses an interface; the address is one that is reserved for documents.
fn own_address() -> Result<IpAddr> {
    let no_network = "this machine has no address in a network; give one with --lan-address";
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).context(no_network)?;
    socket
        .connect((Ipv4Addr::new(192, 0, 2, 1), 9))
        .context(no_network)?;
    let address = socket.local_addr().context(no_network)?.ip();
    if address.is_unspecified() || address.is_loopback() {
        bail!(no_network);
    }
    Ok(address)
}

/// Certificate and key of an address, kept, so that a phone that trusted it once is not asked again.
fn certificate(address: IpAddr, folder: &Path) -> Result<(Vec<u8>, Vec<u8>)> {
    let file = |what: &str| -> PathBuf {
        let name = address.to_string().replace(':', "-");
        folder.join(format!("{name}.{what}.der"))
    };
    if let (Ok(certificate), Ok(key)) = (fs::read(file("certificate")), fs::read(file("key"))) {
        return Ok((certificate, key));
    }
    let CertifiedKey { cert, signing_key } =
        generate_simple_self_signed([address.to_string(), "localhost".to_owned()])
            .context("cannot make a certificate")?;
    let (certificate, key) = (cert.der().to_vec(), signing_key.serialize_der());
    paths::write(&file("certificate"), &certificate)?;
    paths::write(&file("key"), &key)?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        fs::set_permissions(file("key"), fs::Permissions::from_mode(0o600))?;
    }
    Ok((certificate, key))
}

fn config(certificate: Vec<u8>, key: Vec<u8>) -> Result<Arc<ServerConfig>> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key));
    let config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()?
        .with_no_client_auth()
        .with_single_cert(vec![CertificateDer::from(certificate)], key)
        .context("the kept certificate is damaged; remove target/lan")?;
    Ok(Arc::new(config))
}

/// A connection of either kind; deadlines are set at its socket.
pub(super) trait Connection: Read + Write {
    fn socket(&self) -> &TcpStream;
}

impl Connection for TcpStream {
    fn socket(&self) -> &TcpStream {
        self
    }
}

impl Connection for StreamOwned<ServerConnection, TcpStream> {
    fn socket(&self) -> &TcpStream {
        &self.sock
    }
}

/// Shakes hands, which has to be done by `deadline`, however slowly the other side sends.
pub(super) fn shake_hands(
    tls: &Arc<ServerConfig>,
    mut socket: TcpStream,
    deadline: Instant,
) -> Result<StreamOwned<ServerConnection, TcpStream>> {
    let mut connection = ServerConnection::new(Arc::clone(tls))?;
    while connection.is_handshaking() {
        if connection.wants_write() {
            connection.write_tls(&mut socket)?;
            continue;
        }
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            bail!("the handshake did not end in time");
        }
        socket.set_read_timeout(Some(left))?;
        if connection.read_tls(&mut socket)? == 0 {
            bail!("the other side left");
        }
        if let Err(error) = connection.process_new_packets() {
            // Says what is wrong to the other side.
            drop(connection.write_tls(&mut socket));
            return Err(error.into());
        }
    }
    Ok(StreamOwned::new(connection, socket))
}

/// A code for a phone's camera, in half blocks, dark on light whatever the terminal's colours.
pub(super) fn code(url: &str) -> Result<String> {
    let code = QrCode::new(url).context("the address is too long for a code")?;
    let drawn = code
        .render::<Dense1x2>()
        .dark_color(Dense1x2::Light)
        .light_color(Dense1x2::Dark)
        .build();
    let lines = drawn
        .lines()
        .map(|line| format!("\u{1b}[97;40m{line}\u{1b}[0m"));
    Ok(lines.collect::<Vec<_>>().join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustls::pki_types::ServerName;
    use rustls::{ClientConfig, ClientConnection, RootCertStore};
    use std::net::TcpListener;
    use std::time::Duration;

    #[test]
    fn a_certificate_is_kept_and_holds_for_its_address() {
        let folder = std::env::temp_dir().join(format!("landline-lan-{}", std::process::id()));
        let address = IpAddr::from([127, 0, 0, 1]);
        let (made, key) = certificate(address, &folder).expect("can be made");
        assert_eq!(certificate(address, &folder).expect("kept").0, made);
        fs::remove_dir_all(&folder).expect("is there");

        let tls = config(made.clone(), key).expect("fits");
        let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a port");
        let port = listener.local_addr().expect("has one").port();
        let server = std::thread::spawn(move || {
            for _ in 0..2 {
                let (socket, _) = listener.accept().expect("connects");
                let deadline = Instant::now() + Duration::from_secs(10);
                if let Ok(mut stream) = shake_hands(&tls, socket, deadline) {
                    drop(stream.write_all(b"hello"));
                    stream.conn.send_close_notify();
                    drop(stream.flush());
                }
            }
        });
        let mut roots = RootCertStore::empty();
        roots
            .add(CertificateDer::from(made))
            .expect("a certificate");
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let client = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .expect("has some")
            .with_root_certificates(roots)
            .with_no_client_auth();
        let client = Arc::new(client);
        let greet = |name: &str| {
            let name = ServerName::try_from(name.to_owned()).expect("a name");
            let connection = ClientConnection::new(Arc::clone(&client), name).expect("fits");
            let socket = TcpStream::connect(("127.0.0.1", port)).expect("listens");
            let mut text = String::new();
            let mut stream = StreamOwned::new(connection, socket);
            stream.read_to_string(&mut text).map(|_| text)
        };
        assert_eq!(greet("127.0.0.1").expect("trusted"), "hello");
        assert!(greet("192.0.2.7").is_err(), "another address");
        server.join().expect("ends");
    }

    #[test]
    fn a_code_is_square_and_has_its_quiet_zone() {
        let drawn = code("https://192.0.2.1:8443/").expect("short");
        let lines: Vec<&str> = drawn.lines().collect();
        let width = lines[0].chars().filter(|c| "█▀▄ ".contains(*c)).count();
        // Version 2, 25 modules, 4 on either side; two modules a line.
        assert_eq!((width, lines.len()), (33, 17));
    }
}
