//! Thousands of calls with random arguments: each ends with a code and, unless it is OK, with a message.
//! Nothing is written beyond a list.

use std::{
    ffi::{CStr, CString, c_char},
    path::{Path, PathBuf},
    ptr::{null, null_mut},
};

use headtail_c::*;
use headtail_sampling::random::{Purpose, Stream};

/// Entries of every list; calls claim at most as many, or more than any machine has.
const ROOM: usize = 40;
/// Sentinel in result lists beyond the entries that a call may write.
const UNTOUCHED: f32 = 12345.0;
const NUMBERS: [f32; 14] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    1e-3,
    0.999_999_94,
    1e-40,
    1e38,
    -1e38,
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    2.0,
];

/// Random calls, and the objects that they have opened.
struct Caller {
    random: Stream,
    files: Vec<PathBuf>,
    environments: Vec<HeadtailHandle>,
    samplers: Vec<HeadtailHandle>,
    /// A measured and a neural one.
    materials: [HeadtailHandle; 2],
    closed: Vec<HeadtailHandle>,
    /// Number of calls that ended with each code.
    ends: [usize; 4],
}

impl Caller {
    fn below(&mut self, count: usize) -> usize {
        ((self.random.uniform() * count as f32) as usize).min(count - 1)
    }

    fn one_in(&mut self, count: usize) -> bool {
        self.below(count) == 0
    }

    fn one_of<T: Copy>(&mut self, list: &[T]) -> Option<T> {
        if list.is_empty() { None } else { Some(list[self.below(list.len())]) }
    }

    /// Returns a handle, mostly of the right kind.
    fn handle(&mut self, is_sampler: bool) -> HeadtailHandle {
        let wrong = self.one_in(6);
        let list = match self.below(4) {
            0 if wrong => self.closed.clone(),
            1 if wrong => vec![0, 1 << 40, u64::MAX],
            _ if wrong != is_sampler => self.samplers.clone(),
            _ => self.environments.clone(),
        };
        self.one_of(&list).unwrap_or(0)
    }

    /// Returns numbers for a list with `width` numbers per entry: mostly unit vectors and numbers in [0, 1),
    /// some with an invalid number.
    fn list(&mut self, width: usize) -> Vec<f32> {
        let mut list = Vec::with_capacity(ROOM * width);
        for _ in 0..ROOM {
            match width {
                3 => list.extend(self.random.direction().to_array()),
                _ => list.extend((0..width).map(|_| 0.001 + 0.99 * self.random.uniform())),
            }
        }
        if self.one_in(5) {
            let place = self.below(list.len());
            list[place] = NUMBERS[self.below(NUMBERS.len())];
        }
        list
    }

    /// Returns the number of entries that a call claims: the actual one, or more than any machine has.
    fn count(&mut self) -> usize {
        match self.below(12) {
            0 => 0,
            1 => 1,
            2 => usize::MAX / (1 + self.below(4)),
            3 => self.below(ROOM + 1),
            _ => ROOM,
        }
    }

    /// Returns the start of a list, or an invalid pointer.
    fn start(&mut self, list: &[f32]) -> *const f32 {
        match self.below(20) {
            0 => null(),
            1 => (list.as_ptr() as usize + 1 + self.below(3)) as *const f32,
            _ => list.as_ptr(),
        }
    }

    fn text(&mut self, texts: &[&str]) -> Option<CString> {
        let mut bytes = match self.below(20) {
            0 => return None,
            1 => vec![0xff, 0xfe, 0x80],
            2 => (0..self.below(40)).map(|_| b' ' + self.below(224) as u8).collect(),
            _ => texts[self.below(texts.len())].as_bytes().to_vec(),
        };
        if self.one_in(8) && !bytes.is_empty() {
            let place = self.below(bytes.len());
            bytes[place] = b' ' + self.below(95) as u8;
        }
        CString::new(bytes).ok()
    }

    /// Counts and checks the end of a call; returns whether it succeeded.
    fn ended(&mut self, what: &str, status: HeadtailStatus) -> bool {
        self.ends[status as usize] += 1;
        // SAFETY: the message of this thread, unchanged since the call.
        let sentence = unsafe { CStr::from_ptr(headtail_last_error()) }.to_str().unwrap();
        assert_ne!(status, HeadtailStatus::Internal, "{what}: {sentence}");
        let is_ok = status == HeadtailStatus::Ok;
        assert!(is_ok || !sentence.is_empty() && !sentence.contains('\n'), "{what}: {sentence:?}");
        is_ok
    }

    fn opens(&mut self) {
        let (mut handle, choice) = (77, self.below(4));
        let text = match choice {
            0 => self.text(&["overcast", "window", "missing.hdr", "", "/", "/dev/null"]),
            1 => self.text(&[
                "patches",
                "patches:fine",
                "mis",
                "brdf",
                "emitter",
                "ris:4",
                "direct:",
                "mis:mis",
                "uniform",
                "oracle",
            ]),
            _ => {
                let files: Vec<String> = self.files.iter().map(|file| file.display().to_string()).collect();
                self.text(&files.iter().map(String::as_str).collect::<Vec<_>>())
            }
        };
        let name = text.as_ref().map_or(null(), |text| text.as_ptr());
        let environment = self.handle(false);
        let out = if self.one_in(30) { null_mut() } else { &raw mut handle };
        // SAFETY: texts end with a zero byte or are NULL, `out` lives as long as the call or is NULL.
        let status = unsafe {
            match choice {
                0 => headtail_environment_open(name, out),
                1 => headtail_sampler_from_spec(name, environment, out),
                _ => headtail_sampler_open(name, environment, out),
            }
        };
        if self.ended("open", status) {
            if choice == 0 { self.environments.push(handle) } else { self.samplers.push(handle) }
        } else if !out.is_null() {
            assert!(handle == 0 || handle == 77);
        }
    }

    fn texels(&mut self) {
        let (list, mut handle) = (self.list(3), 0);
        let (mut width, mut height) = (1 + self.below(8), 1 + self.below(ROOM / 8));
        if self.one_in(3) {
            let most = usize::MAX >> self.below(40);
            (width, height) = if self.one_in(2) { (most, 1 << 30) } else { (0, most) };
        }
        let texels = self.start(&list);
        // SAFETY: the list has width * height texels, or the size is rejected.
        let status = unsafe { headtail_environment_from_texels(width, height, texels, &mut handle) };
        if self.ended("texels", status) {
            self.environments.push(handle);
        }
    }

    fn describes(&mut self) {
        let (handle, mut text, mut length) = (self.handle(true), [0x55 as c_char; 64], 0);
        let capacity = self.below(text.len());
        let buffer = if self.one_in(10) { null_mut() } else { text.as_mut_ptr() };
        let out = if self.one_in(4) { null_mut() } else { &raw mut length };
        // SAFETY: the buffer has the given capacity.
        let status = unsafe { headtail_sampler_describe(handle, buffer, capacity, out) };
        if self.ended("describe", status) {
            assert!(text[capacity..].iter().all(|byte| *byte == 0x55));
            assert!(buffer.is_null() || capacity == 0 || text[..capacity].contains(&0));
        }
    }

    fn draws(&mut self) {
        let sampler = self.handle(true);
        let mut lists = [3, 3, 1, 1, 1, 1, 3, 3, 2, 4, 1].map(|width| self.list(width));
        lists[9].iter_mut().skip(3).step_by(4).for_each(|hand| *hand = 1.0_f32.copysign(*hand - 0.5));
        let shared = self.one_in(2);
        let mut counts = [0; 11].map(|_| if shared { 1 } else { ROOM });
        if self.one_in(4) {
            let place = self.below(11);
            counts[place] = self.count();
        }
        let mut material =
            if self.one_in(8) { self.handle(true) } else { self.one_of(&self.materials.clone()).unwrap() };
        let mut starts = lists.each_ref().map(|list| if self.one_in(3) { null() } else { self.start(list) });
        // Mostly one kind of surface.
        if !self.one_in(8) {
            let kind = self.below(3);
            for (own, lists) in [2..4, 4..7, 8..11].into_iter().enumerate() {
                if own != kind {
                    starts[lists].fill(null());
                }
            }
            if kind != 2 {
                material = 0;
            } else if material == self.materials[0] {
                starts[8..11].fill(null());
            }
        }
        let n = if self.one_in(20) { null() } else { lists[0].as_ptr() };
        let at = HeadtailPoints {
            n,
            n_count: counts[0],
            wo: starts[1],
            wo_count: counts[1],
            alpha: starts[2],
            alpha_count: counts[2],
            f0: starts[3],
            f0_count: counts[3],
            roughness: starts[4],
            roughness_count: counts[4],
            metallic: starts[5],
            metallic_count: counts[5],
            base_color: starts[6],
            base_color_count: counts[6],
            p: starts[7],
            p_count: counts[7],
            material,
            uv: starts[8],
            uv_count: counts[8],
            tangent: starts[9],
            tangent_count: counts[9],
            footprint: starts[10],
            footprint_count: counts[10],
        };
        let points = if self.one_in(30) { null() } else { &raw const at };
        let (u, given, count, seed) = (self.list(2), self.list(3), self.count(), self.below(1 << 20) as u64);
        let [u, given] = [self.start(&u), self.start(&given)];
        let mut out = [3, 1, 3].map(|width| vec![UNTOUCHED; (ROOM + 1) * width]);
        let [wi, pdf, radiance] =
            out.each_mut().map(|list| if self.one_in(20) { null_mut() } else { list.as_mut_ptr() });
        let (evaluates, prepares, reflects, mut prepared) = (self.one_in(3), self.one_in(3), self.one_in(6), 0);
        // SAFETY: lists have room for the given counts, or are NULL or misaligned, or claim more than is
        // accepted.
        let status = unsafe {
            if reflects {
                headtail_brdf_cosine(points, count, given, wi)
            } else if prepares {
                // The number of prepared points may differ from that of the next call.
                let prepared_count = if self.one_in(5) { self.count() } else { count };
                let status = headtail_points_prepare(sampler, points, prepared_count, &mut prepared);
                if !self.ended("prepare", status) {
                    return;
                }
                if evaluates {
                    headtail_points_pdf(prepared, count, given, pdf)
                } else {
                    headtail_points_sample(prepared, count, u, seed, wi, pdf, radiance)
                }
            } else if evaluates {
                headtail_sampler_pdf(sampler, points, count, given, pdf)
            } else {
                headtail_sampler_sample(sampler, points, count, u, seed, wi, pdf, radiance)
            }
        };
        let is_ok = self.ended("draw", status);
        assert!(prepared == 0 || headtail_close(prepared) == HeadtailStatus::Ok);
        for (list, width) in out.iter().zip([3, 1, 3]) {
            let end = count.min(ROOM) * width;
            assert!(list[end..].iter().all(|number| *number == UNTOUCHED));
            assert!(!is_ok || list[..end].iter().all(|number| number.is_finite()), "{count}");
        }
        assert!(!is_ok || pdf.is_null() || out[1][..count].iter().all(|pdf| *pdf >= 0.0));
    }

    fn closes(&mut self) {
        let is_sampler = self.one_in(2);
        let handle = self.handle(is_sampler);
        if self.ended("close", headtail_close(handle)) {
            self.environments.retain(|other| *other != handle);
            self.samplers.retain(|other| *other != handle);
            self.closed.push(handle);
        }
    }
}

/// Opens a measured and a neural material.
fn materials(folder: &Path) -> [HeadtailHandle; 2] {
    use headtail_sampling::brdf::neural::{INPUTS, Network, OUTPUTS, write_networks};
    let layer = |inputs: usize, outputs: usize| {
        headtail_sampling::head::Linear::new(
            "layer",
            inputs,
            outputs,
            &vec![-0.5; inputs * outputs],
            vec![0.3; outputs],
        )
    };
    let layers = [layer(INPUTS, 2), layer(2, 2), layer(2, OUTPUTS)].map(|layer| layer.unwrap());
    let measured = folder.join("measured.safetensors");
    write_networks(&measured, &[("grey".to_owned(), Network::new("grey", layers).unwrap())]).unwrap();
    let neural = Path::new(env!("CARGO_MANIFEST_DIR")).join("../checkpoints/satin.safetensors");
    [format!("nbrdf:{}#grey", measured.display()), format!("neural:{}", neural.display())].map(|name| {
        let (name, mut handle) = (CString::new(name).unwrap(), 0);
        // SAFETY: the text ends with a zero byte.
        assert_eq!(unsafe { headtail_material_open(name.as_ptr(), &mut handle) }, HeadtailStatus::Ok);
        handle
    })
}

/// Returns a table's file, truncated and modified copies of it, and a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    use headtail_sampling::{bake, environment::Environment, export, tail};
    let map = Environment::open("overcast").unwrap();
    let warp = tail::Tail::of_environment(tail::TailKind::Hierarchical, &map).unwrap();
    let (normals, cells) = (bake::NormalGrid::new(4, 6).unwrap(), bake::CellGrid::new(4, 4).unwrap());
    let table = export::Intermediate::DirectBake(bake::direct_bake(&warp, normals, cells).unwrap());
    let exported = export::ExportedSampler::new(table, tail::TailKind::Hierarchical, &map, None).unwrap();
    let whole = folder.join("table.safetensors");
    exported.write(&whole).unwrap();
    let bytes = std::fs::read(&whole).unwrap();
    let mut random = Stream::new(5, Purpose::Test, 0);
    let mut files = vec![whole, folder.to_owned()];
    for k in 0..60 {
        let mut changed = bytes.clone();
        let place = |random: &mut Stream, count: usize| (random.uniform() * count as f32) as usize;
        if k % 3 == 0 {
            changed.truncate(place(&mut random, bytes.len()));
        } else {
            // Headers matter more than the luminance of texels.
            let length = if k % 3 == 1 { 2000.min(bytes.len()) } else { bytes.len() };
            changed[place(&mut random, length)] ^= 1 << place(&mut random, 8);
        }
        files.push(folder.join(format!("changed{k}")));
        std::fs::write(&files[files.len() - 1], changed).unwrap();
    }
    files
}

#[test]
fn random_calls_end_with_a_code_and_a_message() {
    let folder = tempfile::tempdir().unwrap();
    let calls = std::env::var("HEADTAIL_FUZZ_INPUTS").ok().and_then(|count| count.parse().ok()).unwrap_or(6000);
    let mut caller = Caller {
        random: Stream::new(3, Purpose::Test, 0),
        files: files(folder.path()),
        environments: Vec::new(),
        samplers: Vec::new(),
        materials: materials(folder.path()),
        closed: Vec::new(),
        ends: [0; 4],
    };
    for call in 0..calls {
        match caller.below(24) {
            0 | 1 => caller.opens(),
            2 => caller.texels(),
            3 | 4 => caller.describes(),
            5 => caller.closes(),
            // Few objects are open at a time: each takes many megabytes.
            _ if caller.environments.len() + caller.samplers.len() > 24 => caller.closes(),
            _ => caller.draws(),
        }
        if call % 500 == 499 {
            println!("{} calls, ends {:?}", call + 1, caller.ends);
        }
    }
    // Neither all rejected nor all accepted.
    assert!(caller.ends[0] > calls / 10 && caller.ends[1] > calls / 10, "{:?}", caller.ends);
}
