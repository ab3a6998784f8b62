//! What is served and what is not.

use super::*;
use std::io::Write as _;

fn site(base: &str) -> Site {
    Site {
        dir: PathBuf::from(env!("CARGO_MANIFEST_DIR"))
            .canonicalize()
            .expect("is there"),
        base: base.to_owned(),
        headers: String::new(),
        lan: None,
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
fn files_carry_their_version_and_the_worker_its_policy() {
    let site = site("/");
    let head = |path: &str| answer(&site, &[format!("GET {path} HTTP/1.1")]).head;
    let etag = |path: &str| {
        let head = head(path);
        let line = head.lines().find(|line| line.starts_with("ETag: "));
        line.expect("has one").to_owned()
    };
    assert_eq!(etag("/Cargo.toml"), etag("/Cargo.toml"));
    assert_ne!(etag("/Cargo.toml"), etag("/src/main.rs"));
    assert!(!head("/Cargo.toml").contains("Content-Security-Policy"));
    let folder = std::env::temp_dir().join(format!("landline-serve-worker-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("writable");
    fs::write(folder.join("worker.js"), "").expect("writable");
    let site = Site {
        dir: folder.canonicalize().expect("is there"),
        ..site
    };
    let head = answer(&site, &["GET /worker.js HTTP/1.1".to_owned()]).head;
    assert!(head.contains(WORKER_POLICY), "{head}");
    fs::remove_dir_all(&folder).expect("is there");
}

#[test]
fn answers_to_the_names_of_this_machine_only() {
    let site = site("/");
    let status = |host: &str| {
        let head = [
            "GET /Cargo.toml HTTP/1.1".to_owned(),
            format!("Host: {host}"),
        ];
        let answer = answer(&site, &head);
        answer.head.lines().next().unwrap_or("").to_owned()
    };
    for host in [
        "localhost:8080",
        "LocalHost",
        "127.0.0.1:1",
        "[::1]:8080",
        "[::1]",
    ] {
        assert_eq!(status(host), "HTTP/1.1 200 OK", "{host}");
    }
    for host in [
        "evil.example:8080",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "",
    ] {
        assert_eq!(status(host), "HTTP/1.1 421 Misdirected Request", "{host}");
    }
}

#[cfg(unix)]
#[test]
fn links_out_of_the_folder_lead_nowhere() {
    let folder = std::env::temp_dir().join(format!("landline-serve-{}", std::process::id()));
    fs::create_dir_all(folder.join("site/a")).expect("writable");
    fs::write(folder.join("private.txt"), "private").expect("writable");
    fs::write(folder.join("site/own.txt"), "own").expect("writable");
    let link = |from: &str, to: &str| {
        std::os::unix::fs::symlink(from, folder.join(to)).expect("writable");
    };
    link("../private.txt", "site/out.txt");
    link("..", "site/up");
    link("own.txt", "site/in.txt");
    let site = Site {
        dir: folder.join("site").canonicalize().expect("is there"),
        ..site("/")
    };
    assert_eq!(status(&site, "GET /in.txt HTTP/1.1"), "HTTP/1.1 200 OK");
    for path in ["out.txt", "up/private.txt"] {
        assert_eq!(
            status(&site, &format!("GET /{path} HTTP/1.1")),
            "HTTP/1.1 404 Not Found"
        );
    }
    fs::remove_dir_all(&folder).expect("exists");
}

#[test]
fn a_sender_of_single_bytes_is_dropped_at_its_deadline() {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a port");
    let address = listener.local_addr().expect("has one");
    #[allow(clippy::disallowed_methods, reason = "a slow sender is what is tested")]
    let sender = std::thread::spawn(move || {
        let mut stream = TcpStream::connect(address).expect("listens");
        // Until the other side hangs up.
        while stream.write_all(b"G").is_ok() {
            std::thread::sleep(Duration::from_millis(20));
        }
    });
    let (stream, _) = listener.accept().expect("connects");
    let mut reader = BufReader::new(stream);
    let deadline = Instant::now() + Duration::from_millis(200);
    assert!(line_before(&mut reader, deadline).is_err());
    drop(reader);
    sender.join().expect("stops by itself");
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
