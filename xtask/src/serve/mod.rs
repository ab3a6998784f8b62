//! `cargo xtask serve`: a static server for the demo page on this machine. It can behave like the hosts that are hard
//! on a page: a sub-path instead of the root, strict policy headers, cross-origin isolation.

mod lan;

use crate::paths;
use anyhow::{Context as _, Result, bail};
use lan::{Connection, Lan};
use std::fs;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::io::{BufRead as _, BufReader};
use std::net::{IpAddr, Ipv4Addr, TcpListener, TcpStream};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// A request's head has to arrive within this time, however it is cut up.
const HEAD_TIME: Duration = Duration::from_secs(10);
/// How long a connection may wait for its next request, and how long an answer may be stuck.
const IDLE_TIME: Duration = Duration::from_secs(30);
/// Connections at once; a browser opens six.
const MAX_CONNECTIONS: usize = 128;

/// Serves the demo page on this machine.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Args {
    /// Folder to serve; the staged demo page when left out.
    #[arg(long)]
    pub(crate) dir: Option<PathBuf>,
    /// Port; 0 takes a free one.
    #[arg(long, default_value_t = 8080)]
    pub(crate) port: u16,
    /// Path that the page lives under, as on hosts that give each project a folder.
    #[arg(long, default_value = "/")]
    pub(crate) base: String,
    /// Sends the page's content security policy as a header too, as a strict host does.
    #[arg(long)]
    pub(crate) strict: bool,
    /// Sends the headers that make a page cross-origin isolated.
    #[arg(long)]
    pub(crate) isolated: bool,
    /// Also for other devices of this network, such as a phone: by HTTPS with a certificate made here, and with a code to scan.
    /// Everybody in the network can then read what is served.
    #[arg(long)]
    pub(crate) lan: bool,
    /// This machine's address in the network, where the one that is found is not the right one.
    #[arg(long, requires = "lan", value_name = "IP")]
    pub(crate) lan_address: Option<IpAddr>,
}

impl Default for Args {
    fn default() -> Self {
        Self {
            dir: None,
            port: 8080,
            base: "/".to_owned(),
            strict: false,
            isolated: false,
            lan: false,
            lan_address: None,
        }
    }
}

#[derive(Debug)]
struct Site {
    /// Without links, so that a file can be seen to lie in it.
    dir: PathBuf,
    /// Begins and ends with a slash.
    base: String,
    headers: String,
    /// For other devices of the network.
    lan: Option<Lan>,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    Server::bind(args)?.run();
    Ok(())
}

/// A server that has its port and waits for its first visitor.
#[derive(Debug)]
pub(crate) struct Server {
    listener: TcpListener,
    site: Arc<Site>,
    /// Where the page is.
    pub(crate) url: String,
}

impl Server {
    /// Takes a port.
    ///
    /// # Errors
    ///
    /// When there is nothing to serve or no port.
    pub(crate) fn bind(args: &Args) -> Result<Self> {
        let dir = args.dir.clone().unwrap_or_else(paths::site);
        if !dir.is_dir() {
            bail!(
                "{} is not there: run `cargo xtask web` first",
                dir.display()
            );
        }
        let mut headers =
            String::from("Cache-Control: no-cache\r\nX-Content-Type-Options: nosniff\r\n");
        if args.strict {
            headers.push_str(&policy(&dir)?);
            headers
                .push_str("Referrer-Policy: no-referrer\r\nPermissions-Policy: camera=(self)\r\n");
        }
        if args.isolated {
            headers.push_str("Cross-Origin-Opener-Policy: same-origin\r\nCross-Origin-Embedder-Policy: require-corp\r\n");
        }
        let base = format!("/{}/", args.base.trim_matches('/')).replace("//", "/");
        let lan = args.lan.then(|| Lan::new(args.lan_address)).transpose()?;
        let interface = if lan.is_some() {
            Ipv4Addr::UNSPECIFIED
        } else {
            Ipv4Addr::LOCALHOST
        };
        let listener = listen(interface, args.port)?;
        let port = listener.local_addr()?.port();
        let url = match &lan {
            Some(Lan {
                address: IpAddr::V6(address),
                ..
            }) => format!("https://[{address}]:{port}{base}"),
            Some(Lan { address, .. }) => format!("https://{address}:{port}{base}"),
            None => format!("http://localhost:{port}{base}"),
        };
        let dir = dir
            .canonicalize()
            .with_context(|| format!("cannot open {}", dir.display()))?;
        let site = Arc::new(Site {
            dir,
            base,
            headers,
            lan,
        });
        Ok(Self {
            listener,
            site,
            url,
        })
    }

    /// Serves until the process ends.
    pub(crate) fn run(&self) {
        println!(
            "serving {} at {} (Ctrl+C stops)",
            self.site.dir.display(),
            self.url
        );
        if self.site.lan.is_some() {
            if let Ok(code) = lan::code(&self.url) {
                println!("\n{code}\n");
            }
            println!(
                "Scan it with a device of the same network. Its browser does not know the certificate, which was made here: choose\n\
                 \"advanced\", then go on. Everybody in the network can read what is served."
            );
        }
        self.answer_all();
    }

    /// Serves and says nothing.
    pub(crate) fn answer_all(&self) {
        let num_open = Arc::new(AtomicUsize::new(0));
        for stream in self.listener.incoming().flatten() {
            if num_open.fetch_add(1, Ordering::Relaxed) >= MAX_CONNECTIONS {
                num_open.fetch_sub(1, Ordering::Relaxed);
                continue;
            }
            let (site, num_open) = (Arc::clone(&self.site), Arc::clone(&num_open));
            std::thread::spawn(move || {
                // A browser that went away is no news.
                drop(greet(&site, stream));
                num_open.fetch_sub(1, Ordering::Relaxed);
            });
        }
    }
}

/// A page's policy in a `<meta>` element does not reach its worker: nothing but the scripts beside it, so that `import()`
/// leads nowhere else.
const WORKER_POLICY: &str =
    "Content-Security-Policy: default-src 'none'; script-src 'self' 'wasm-unsafe-eval'\r\n";

/// Only this machine's loopback unless asked otherwise: the page may hold a private scene.
fn listen(interface: Ipv4Addr, port: u16) -> Result<TcpListener> {
    match TcpListener::bind((interface, port)) {
        Ok(listener) => Ok(listener),
        Err(error) if error.kind() == std::io::ErrorKind::AddrInUse => {
            TcpListener::bind((interface, 0))
                .context("no free port")
                .inspect(|_| {
                    println!("port {port} is in use, taking another");
                })
        }
        Err(error) => Err(error).with_context(|| format!("cannot listen on port {port}")),
    }
}

/// The policy in the page's own `<meta>`, as a header.
fn policy(dir: &Path) -> Result<String> {
    let html = fs::read_to_string(dir.join("index.html")).context("the page has no index.html")?;
    let policy = html
        .split_once("Content-Security-Policy\" content=\"")
        .and_then(|(_, rest)| rest.split_once('"'))
        .map(|(policy, _)| policy)
        .context("index.html carries no Content-Security-Policy to send")?;
    Ok(format!(
        "Content-Security-Policy: {policy}; frame-ancestors 'none'\r\n"
    ))
}

fn greet(site: &Site, stream: TcpStream) -> Result<()> {
    stream.set_write_timeout(Some(IDLE_TIME))?;
    match &site.lan {
        None => serve(site, stream),
        Some(lan) => serve(
            site,
            lan::shake_hands(&lan.tls, stream, Instant::now() + HEAD_TIME)?,
        ),
    }
}

fn serve(site: &Site, stream: impl Connection) -> Result<()> {
    let mut reader = BufReader::new(stream);
    loop {
        // The first byte may take its time, what follows may not.
        let socket = reader.get_ref().socket();
        socket.set_read_timeout(Some(IDLE_TIME))?;
        if reader.fill_buf()?.is_empty() {
            return Ok(());
        }
        let deadline = Instant::now() + HEAD_TIME;
        let mut head = Vec::new();
        loop {
            let line = line_before(&mut reader, deadline)?;
            if line == b"\r\n" || line == b"\n" {
                break;
            }
            head.push(String::from_utf8_lossy(&line).trim_end().to_owned());
            if head.len() > 200 {
                bail!("too many header lines");
            }
        }
        let answer = answer(site, &head);
        let out = reader.get_mut();
        out.write_all(answer.head.as_bytes())?;
        out.write_all(&answer.body)?;
        out.flush()?;
    }
}

/// One line, its end included, that has to be there by `deadline`: a sender of single bytes holds no thread for ever.
fn line_before(reader: &mut BufReader<impl Connection>, deadline: Instant) -> Result<Vec<u8>> {
    // Ample for a browser's line.
    const MAX_LINE: usize = 16 << 10;
    let mut line = Vec::new();
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            bail!("the request did not arrive in time");
        }
        reader.get_ref().socket().set_read_timeout(Some(left))?;
        let bytes = reader.fill_buf()?;
        if bytes.is_empty() {
            bail!("the request ends in its head");
        }
        let end = bytes.iter().position(|b| *b == b'\n').map(|at| at + 1);
        let taken = end.unwrap_or(bytes.len());
        line.extend_from_slice(&bytes[..taken]);
        reader.consume(taken);
        if end.is_some() {
            return Ok(line);
        }
        if line.len() > MAX_LINE {
            bail!("a header line is too long");
        }
    }
}

/// Whether a request asks for this machine by its own name. A page of the web can have its name point here (DNS rebinding);
/// its requests still carry that name. Requests without a name come from no browser.
fn is_own(site: &Site, head: &[String]) -> bool {
    let address = site.lan.as_ref().map(|lan| lan.address);
    head.iter()
        .skip(1)
        .filter_map(|line| line.split_once(':'))
        .filter(|(name, _)| name.eq_ignore_ascii_case("host"))
        .all(|(_, host)| {
            let host = host.trim();
            let name = match host.rsplit_once(':') {
                Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
                _ => host,
            };
            let is_address = |own: IpAddr| {
                let name = name.trim_start_matches('[').trim_end_matches(']');
                name.parse() == Ok(own)
            };
            ["localhost", "127.0.0.1", "[::1]"]
                .iter()
                .any(|own| name.eq_ignore_ascii_case(own))
                || address.is_some_and(is_address)
        })
}

#[derive(Debug)]
struct Answer {
    head: String,
    body: Vec<u8>,
}

fn answer(site: &Site, head: &[String]) -> Answer {
    let mut words = head.first().map_or("", String::as_str).split(' ');
    let (method, target) = (words.next().unwrap_or(""), words.next().unwrap_or(""));
    if !matches!(method, "GET" | "HEAD") {
        return reply(
            site,
            "405 Method Not Allowed",
            "text/plain",
            "",
            b"only GET and HEAD".to_vec(),
            false,
        );
    }
    let is_head = method == "HEAD";
    if !is_own(site, head) {
        return reply(
            site,
            "421 Misdirected Request",
            "text/plain",
            "",
            b"this server answers to its own address only".to_vec(),
            is_head,
        );
    }
    let Some(path) = file(site, target) else {
        return reply(
            site,
            "404 Not Found",
            "text/plain",
            "",
            b"not found".to_vec(),
            is_head,
        );
    };
    let Ok(body) = fs::read(&path) else {
        return reply(
            site,
            "404 Not Found",
            "text/plain",
            "",
            b"not found".to_vec(),
            is_head,
        );
    };
    let mime = mime(&path);
    // So that what was kept on a device is known to be old when the file changes.
    let mut hasher = DefaultHasher::new();
    body.hash(&mut hasher);
    let mut own = format!("ETag: \"{:016x}\"\r\n", hasher.finish());
    if path.ends_with("worker.js") {
        own.push_str(WORKER_POLICY);
    }
    // Video players seek with ranges.
    let range = head.iter().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.eq_ignore_ascii_case("range")
            .then(|| span(value.trim(), body.len()))
            .flatten()
    });
    match range {
        Some((first, last)) => {
            let extra = format!(
                "Content-Range: bytes {first}-{last}/{}\r\n{own}",
                body.len()
            );
            let part = body.get(first..=last).unwrap_or_default().to_vec();
            reply(site, "206 Partial Content", mime, &extra, part, is_head)
        }
        None => reply(
            site,
            "200 OK",
            mime,
            &format!("Accept-Ranges: bytes\r\n{own}"),
            body,
            is_head,
        ),
    }
}

fn reply(
    site: &Site,
    status: &str,
    mime: &str,
    extra: &str,
    body: Vec<u8>,
    is_head: bool,
) -> Answer {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {mime}\r\nContent-Length: {}\r\n{extra}{}\r\n",
        body.len(),
        site.headers
    );
    Answer {
        head,
        body: if is_head { Vec::new() } else { body },
    }
}

/// First and last byte of `bytes=a-b`, clipped to what is there.
fn span(value: &str, len: usize) -> Option<(usize, usize)> {
    let (first, last) = value.strip_prefix("bytes=")?.split_once('-')?;
    let end = len.checked_sub(1)?;
    let (first, last) = match (first.parse::<usize>(), last.parse::<usize>()) {
        (Ok(first), Ok(last)) => (first, last.min(end)),
        (Ok(first), Err(_)) => (first, end),
        (Err(_), Ok(suffix)) => (len.saturating_sub(suffix), end),
        (Err(_), Err(_)) => return None,
    };
    (first <= last).then_some((first, last))
}

/// The file that a request names, if it is one of the site's.
fn file(site: &Site, target: &str) -> Option<PathBuf> {
    let target = target.split(['?', '#']).next()?;
    let rel = percent_decoded(target.strip_prefix(site.base.as_str())?)?;
    let rel = Path::new(&rel);
    // Nothing may lead out of the folder.
    if !rel
        .components()
        .all(|part| matches!(part, Component::Normal(_)))
    {
        return None;
    }
    let path = site.dir.join(rel);
    let path = if path.is_dir() {
        path.join("index.html")
    } else {
        path
    };
    // Nor may a link in it.
    let path = path.canonicalize().ok()?;
    path.starts_with(&site.dir).then_some(path)
}

fn percent_decoded(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        if byte == b'%' {
            let digits = [rest.next()?, rest.next()?];
            bytes.push(u8::from_str_radix(std::str::from_utf8(&digits).ok()?, 16).ok()?);
        } else {
            bytes.push(byte);
        }
    }
    String::from_utf8(bytes).ok()
}

fn mime(path: &Path) -> &'static str {
    match path.extension().and_then(|ext| ext.to_str()).unwrap_or("") {
        "html" => "text/html; charset=utf-8",
        "js" | "mjs" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "json" => "application/json",
        "webmanifest" => "application/manifest+json",
        "wasm" => "application/wasm",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "jpg" | "jpeg" => "image/jpeg",
        "webp" => "image/webp",
        "ico" => "image/x-icon",
        "mp4" => "video/mp4",
        "webm" => "video/webm",
        "txt" | "md" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests;
