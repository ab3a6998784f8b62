//! `cargo xtask serve`: a static server for the demo page on this machine. It can behave like the hosts that are hard
//! on a page: a sub-path instead of the root, strict policy headers, cross-origin isolation.

use crate::paths;
use anyhow::{Context as _, Result, bail};
use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

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
}

impl Default for Args {
    fn default() -> Self {
        Self {
            dir: None,
            port: 8080,
            base: "/".to_owned(),
            strict: false,
            isolated: false,
        }
    }
}

#[derive(Debug)]
struct Site {
    dir: PathBuf,
    /// Begins and ends with a slash.
    base: String,
    headers: String,
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
        let listener = listen(args.port)?;
        let url = format!("http://localhost:{}{base}", listener.local_addr()?.port());
        let site = Arc::new(Site { dir, base, headers });
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
        self.answer_all();
    }

    /// Serves and says nothing.
    pub(crate) fn answer_all(&self) {
        for stream in self.listener.incoming().flatten() {
            let site = Arc::clone(&self.site);
            std::thread::spawn(move || {
                // A browser that went away is no news.
                drop(serve(&site, &stream));
            });
        }
    }
}

/// Only this machine's loopback: the page may hold a private scene.
fn listen(port: u16) -> Result<TcpListener> {
    match TcpListener::bind(("127.0.0.1", port)) {
        Ok(listener) => Ok(listener),
        Err(error) if error.kind() == std::io::ErrorKind::AddrInUse => {
            TcpListener::bind(("127.0.0.1", 0))
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

fn serve(site: &Site, stream: &TcpStream) -> Result<()> {
    stream.set_read_timeout(Some(Duration::from_secs(30)))?;
    let mut reader = BufReader::new(stream);
    loop {
        let mut head = Vec::new();
        loop {
            let mut line = Vec::new();
            // 16 KiB is ample for a browser's line; what is longer is cut, and then not understood.
            if reader
                .by_ref()
                .take(16 << 10)
                .read_until(b'\n', &mut line)?
                == 0
            {
                return Ok(());
            }
            if line == b"\r\n" || line == b"\n" {
                break;
            }
            head.push(String::from_utf8_lossy(&line).trim_end().to_owned());
            if head.len() > 200 {
                bail!("too many header lines");
            }
        }
        let answer = answer(site, &head);
        let mut out = stream;
        out.write_all(answer.head.as_bytes())?;
        out.write_all(&answer.body)?;
        out.flush()?;
    }
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
    // Video players seek with ranges.
    let range = head.iter().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.eq_ignore_ascii_case("range")
            .then(|| span(value.trim(), body.len()))
            .flatten()
    });
    match range {
        Some((first, last)) => {
            let extra = format!("Content-Range: bytes {first}-{last}/{}\r\n", body.len());
            let part = body.get(first..=last).unwrap_or_default().to_vec();
            reply(site, "206 Partial Content", mime, &extra, part, is_head)
        }
        None => reply(
            site,
            "200 OK",
            mime,
            "Accept-Ranges: bytes\r\n",
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
    Some(if path.is_dir() {
        path.join("index.html")
    } else {
        path
    })
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
mod tests {
    use super::*;

    fn site(base: &str) -> Site {
        Site {
            dir: PathBuf::from(env!("CARGO_MANIFEST_DIR")),
            base: base.to_owned(),
            headers: String::new(),
        }
    }

    fn status(site: &Site, line: &str) -> String {
        answer(site, &[line.to_owned()])
            .head
            .lines()
            .next()
            .unwrap_or("")
            .to_owned()
    }

    #[test]
    fn serves_files_of_the_folder_only() {
        let site = site("/");
        assert_eq!(status(&site, "GET /Cargo.toml HTTP/1.1"), "HTTP/1.1 200 OK");
        assert_eq!(
            status(&site, "GET /src/../Cargo.toml HTTP/1.1"),
            "HTTP/1.1 404 Not Found"
        );
        assert_eq!(
            status(&site, "GET /%2e%2e/Cargo.toml HTTP/1.1"),
            "HTTP/1.1 404 Not Found"
        );
        assert_eq!(
            status(&site, "GET //etc/hostname HTTP/1.1"),
            "HTTP/1.1 404 Not Found"
        );
        assert_eq!(
            status(&site, "POST /Cargo.toml HTTP/1.1"),
            "HTTP/1.1 405 Method Not Allowed"
        );
        assert_eq!(status(&site, ""), "HTTP/1.1 405 Method Not Allowed");
    }

    #[test]
    fn serves_below_a_sub_path() {
        let site = site("/landline/");
        assert_eq!(
            status(&site, "GET /landline/Cargo.toml?v=1 HTTP/1.1"),
            "HTTP/1.1 200 OK"
        );
        assert_eq!(
            status(&site, "GET /Cargo.toml HTTP/1.1"),
            "HTTP/1.1 404 Not Found"
        );
    }

    #[test]
    fn streams_wasm_with_its_own_type() {
        // `WebAssembly.compileStreaming` refuses any other.
        assert_eq!(mime(Path::new("a/b.wasm")), "application/wasm");
    }

    #[test]
    fn reads_ranges() {
        assert_eq!(span("bytes=0-3", 10), Some((0, 3)));
        assert_eq!(span("bytes=4-", 10), Some((4, 9)));
        assert_eq!(span("bytes=-3", 10), Some((7, 9)));
        assert_eq!(span("bytes=4-99", 10), Some((4, 9)));
        assert_eq!(span("bytes=10-", 10), None);
        assert_eq!(span("bytes=0-", 0), None);
    }
}
