//! The page of `headtail live` in a browser whose WebGPU runs in software: its films hold the pictures of `render`.
//!
//! Needs `chromium` with SwiftShader; reports a skip without. The browser in the variable HEADTAIL_CHROMIUM must exist.

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use headtail_render::image::read_radiance;

use super::{browser::browser, fail, folder, succeed};

const WIDTH: usize = 48;
const HEIGHT: usize = 32;
/// Patches with precomputed visibility.
const SEEN: &str = "patches+vis:seen.safetensors";
/// Samples of each pixel, by the page's address.
const SAMPLES: usize = 3;
const LIMIT: Duration = Duration::from_secs(240);

/// Waits for the samples, and sends what the page says and its films.
const PROBE: &str = include_str!("live.js");

#[test]
fn live_pages_render_what_the_program_renders() {
    let here = folder();
    let path = here.path();
    let view = format!("--scene bedroom --env sunset --material ggx:alpha=0.3 --width {WIDTH} --height {HEIGHT}");
    // Learned from so many rays that a picture of few samples does not learn more.
    succeed(path, &format!("bake --visibility {view} --spp 64 --out seen.safetensors"));
    succeed(path, &format!("live {view} --samplers mis2:portals,{SEEN} --out page.html"));
    let said = fail(path, &format!("live {view} --samplers patches+vis --out other.html"));
    assert!(said.contains("name a file of bake --visibility"), "{said}");
    let page = fs::read_to_string(path.join("page.html")).unwrap();
    assert!(!page.contains("http:") && !page.contains("https:"), "the page loads something");
    let said = fail(path, &format!("live {view} --samplers auto --out other.html"));
    assert!(said.contains("sampler 'auto': not rendered on a device"), "{said}");
    let said = fail(path, &format!("live {view} --samplers mis --points sobol --out other.html"));
    assert!(said.contains("--points sobol") && !path.join("other.html").exists(), "{said}");

    let Some(browser) = browser() else { return };
    let sent = open(&browser, &page);
    let said = String::from_utf8(sent.iter().find(|(name, _)| name == "/done").expect("an answer").1.clone()).unwrap();
    if said.contains("has no WebGPU") || said.contains("no graphics adapter") {
        eprintln!("skipped: {browser}: {said}");
        return;
    }
    for (side, sampler, seed) in [("/left", "mis2:portals", 1), ("/right", SEEN, 2)] {
        let (_, bytes) = sent.iter().find(|(name, _)| name == side).unwrap_or_else(|| panic!("{side}: {said}"));
        let (chunks, _) = bytes.as_chunks::<4>();
        let film: Vec<f32> = chunks.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        assert_eq!(film.len(), 12 * WIDTH * HEIGHT);
        let out = format!("{seed}.exr");
        succeed(
            path,
            &format!(
                "render {view} --visibility-always --sampler {sampler} --points lattice:64 --spp {SAMPLES} --seed {seed} --out {out}"
            ),
        );
        let expected = read_radiance(&path.join(out)).unwrap();
        let color = |k: usize| [0, 1, 2].map(|c| (film[12 * k + c] + film[12 * k + 4 + c]) / SAMPLES as f32);
        let is_apart = |k: usize, expected: &[f32; 3]| {
            let scale = expected.iter().fold(1e-3_f32, |largest, x| largest.max(*x));
            color(k).iter().zip(expected).any(|(a, b)| (a - b).abs() > 1e-3 * scale)
        };
        // Rays and draws that rounding moves across an edge.
        let apart = expected.pixels.iter().enumerate().filter(|(k, pixel)| is_apart(*k, pixel)).count();
        assert!(apart <= WIDTH * HEIGHT / 50, "{sampler}: {apart} pixels");
        assert!(expected.pixels.iter().flatten().sum::<f32>() > 0.0);
    }
}

/// Opens a page with the probe, and returns what it sends.
fn open(browser: &str, page: &str) -> Vec<(String, Vec<u8>)> {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = format!("http://{}/#spp={SAMPLES}", listener.local_addr().unwrap());
    let probe = PROBE.replace("SAMPLES", &SAMPLES.to_string());
    // Only for the probe may the page send.
    let page = page
        .replace("default-src 'none'; ", "default-src 'none'; connect-src 'self'; ")
        .replace("</body>", &format!("<script>{probe}</script></body>"));
    let profile = folder();
    let mut command = Command::new(browser);
    command.args(
        "--headless=new --no-sandbox --no-first-run --enable-unsafe-webgpu --use-webgpu-adapter=swiftshader".split(' '),
    );
    command.args("--enable-unsafe-swiftshader --ignore-gpu-blocklist --enable-gpu --enable-features=Vulkan".split(' '));
    command.args(["--use-vulkan=swiftshader", "--use-angle=swiftshader"]);
    command.arg(format!("--user-data-dir={}", profile.path().display())).arg(address);
    let _browser = Running(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap());
    let (mut sent, start) = (Vec::new(), Instant::now());
    while start.elapsed() < LIMIT && !sent.iter().any(|(name, _): &(String, Vec<u8>)| name == "/done") {
        match listener.accept() {
            Ok((stream, _)) => sent.extend(answer(stream, &page)),
            Err(_) => std::thread::sleep(Duration::from_millis(20)),
        }
    }
    sent
}

/// A browser that ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        drop((self.0.kill(), self.0.wait()));
    }
}

/// Answers a request: the page, or takes what is sent and returns it with its path.
fn answer(stream: TcpStream, page: &str) -> Option<(String, Vec<u8>)> {
    stream.set_nonblocking(false).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(30))).ok()?;
    let mut reader = BufReader::new(stream);
    let mut request = String::new();
    reader.read_line(&mut request).ok()?;
    let mut length = 0;
    loop {
        let mut line = String::new();
        reader.read_line(&mut line).ok()?;
        match line.trim().to_ascii_lowercase().split_once(':') {
            Some(("content-length", number)) => length = number.trim().parse().ok()?,
            Some(_) => {}
            None => break,
        }
    }
    let mut parts = request.split(' ');
    let (method, name) = (parts.next()?, parts.next()?.to_owned());
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    let content = if method == "GET" && name == "/" { page } else { "" };
    let head = "HTTP/1.1 200 OK\r\nContent-Type: text/html; charset=utf-8\r\nConnection: close";
    write!(reader.get_mut(), "{head}\r\nContent-Length: {}\r\n\r\n{content}", content.len()).ok()?;
    (method == "POST").then_some((name, body))
}
