//! Rejected files: errors name the invalid entry, and nothing panics.

use super::*;

#[test]
fn truncated_files_are_refused_at_every_length() {
    let folder = Folder::new();
    for sampler in [&samplers()[1], &samplers()[4]] {
        let bytes = folder.bytes_of(sampler);
        // Every length of the first bytes, then strides, then every length of the last ones.
        let lengths = (0..64).chain((64..bytes.len()).step_by(23)).chain(bytes.len() - 64..bytes.len());
        for length in lengths {
            folder.refused(&bytes[..length]);
        }
        folder.refused(&[&bytes[..], &[0; 4]].concat());
    }
}

#[test]
fn flipped_bytes_never_panic() {
    let folder = Folder::new();
    let mut accepted = 0;
    for sampler in [&samplers()[1], &samplers()[2], &samplers()[5], &samplers()[10]] {
        let bytes = folder.bytes_of(sampler);
        let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        let mut random = Stream::new(2, Purpose::Test, 0);
        for round in 0..1500 {
            let mut bytes = bytes.clone();
            // 2/3 of the mutations hit the header; a few hit several bytes.
            let (start, end) = if round % 3 < 2 { (0, header) } else { (header, bytes.len()) };
            for _ in 0..1 + round % 3 {
                let place = start + ((end - start) as f32 * random.uniform()) as usize;
                let flip = 1 + (255.0 * random.uniform()) as u8;
                bytes[place.min(end - 1)] ^= flip;
            }
            // Accepted files must draw without a panic, too.
            if let Ok(read) = folder.read(&bytes) {
                accepted += 1;
                draws(&read, 20);
            }
        }
    }
    assert!(accepted > 100, "{accepted}: mutations of weights are accepted, or nothing past the header was tested");
}

#[test]
fn wrong_descriptions_are_refused_by_name() {
    let folder = Folder::new();
    let head = folder.bytes_of(&samplers()[1]);
    let refused = |change: &dyn Fn(&mut Value)| folder.refused(&Parts::of(&head).describe(change));
    let expect = |error: &str, words: &[&str]| words.iter().for_each(|word| assert!(error.contains(word), "{error}"));

    expect(&refused(&|d| d["format_version"] = json!(5)), &["format_version", "is 5", "reads versions 1 to 4"]);
    expect(&refused(&|d| d["format_version"] = json!(-1)), &["format_version"]);
    expect(&refused(&|d| d["format_version"] = json!("1")), &["format_version"]);
    expect(&refused(&|d| drop(d.as_object_mut().unwrap().remove("format_version"))), &["format_version", "none"]);
    expect(&refused(&|d| d["visibility"] = json!(true)), &["visibility"]);
    expect(&refused(&|d| d["compact_emitters"] = json!(true)), &["compact_emitters", "headtail fit", "patches"]);
    expect(&refused(&|d| d["training"]["colour"] = json!(1)), &["colour"]);
    expect(&refused(&|d| d["intermediate"]["bins"] = json!(1)), &["bins"]);
    expect(&refused(&|d| d["tail"] = json!("spiral")), &["spiral"]);
    expect(&refused(&|d| d["condition"] = json!("visibility")), &["visibility"]);
    // Conditions differ in length.
    expect(&refused(&|d| d["condition"] = json!("ggx")), &["encoder.linear0", "after 10"]);
    expect(&refused(&|d| d["intermediate"]["kind"] = json!("mixture")), &["mixture"]);
    expect(&refused(&|d| d["intermediate"]["mode"] = json!("both")), &["both"]);
    expect(&refused(&|d| d["intermediate"]["leaky_slope"] = json!(-0.5)), &["leaky_slope"]);
    expect(&refused(&|d| d["intermediate"]["leaky_slope"] = json!(1e300)), &["leaky_slope"]);
    expect(&refused(&|d| d["intermediate"]["encoder_layers"] = json!(usize::MAX)), &["encoder", "16"]);
    expect(&refused(&|d| d["intermediate"]["network_layers"] = json!(0)), &["layer0"]);
    expect(&refused(&|d| d["intermediate"]["network_layers"] = json!(4)), &["layer0.linear3.weight", "missing"]);
    // A layer missing from the description is an unknown tensor, not ignored.
    expect(&refused(&|d| d["intermediate"]["encoder_layers"] = json!(1)), &["layer0.linear0"]);
    expect(&refused(&|d| d["intermediate"] = json!({"kind": "bake"})), &["table.masses", "missing"]);
    // Modes differ in inputs.
    expect(&refused(&|d| d["intermediate"]["mode"] = json!("autoregressive")), &["layer0.linear0"]);
    expect(&refused(&|d| *d = json!([1, 2])), &["format_version"]);

    let mut parts = Parts::of(&head);
    parts.header["__metadata__"]["headtail"] = "{".into();
    expect(&folder.refused(&parts.bytes()), &["metadata 'headtail'"]);
    parts.header.as_object_mut().unwrap().remove("__metadata__");
    expect(&folder.refused(&parts.bytes()), &["metadata 'headtail'", "missing"]);
}

#[test]
fn wrong_tensors_are_refused_by_name() {
    let folder = Folder::new();
    let head = folder.bytes_of(&samplers()[1]);
    let bake = folder.bytes_of(&samplers()[4]);
    let expect = |bytes: &[u8], words: &[&str]| {
        let error = folder.refused(bytes);
        words.iter().for_each(|word| assert!(error.contains(word), "{error}"));
    };
    let (weight, luminance) = ("layer1.linear1.weight", "tail.luminance");

    let mut parts = Parts::of(&head);
    let entry = parts.header.as_object_mut().unwrap().remove(weight).unwrap();
    parts.header["layer1.linear1.w"] = entry;
    expect(&parts.bytes(), &[weight, "missing"]);

    let mut parts = Parts::of(&head);
    let end = parts.body.len();
    parts.header["notes"] = json!({"dtype": "F32", "shape": [1], "data_offsets": [end, end + 4]});
    parts.body.extend([0; 4]);
    expect(&parts.bytes(), &["tensor 'notes'", "not known"]);

    for dtype in ["I32", "U32"] {
        expect(&Parts::of(&head).entry(weight, |e| e["dtype"] = json!(dtype)), &[weight, "f32"]);
        expect(&Parts::of(&head).entry(luminance, |e| e["dtype"] = json!(dtype)), &[luminance, "f32"]);
    }
    expect(&Parts::of(&head).entry(weight, |e| e["dtype"] = json!("F64")), &["header"]);
    expect(&Parts::of(&head).entry(weight, |e| e["shape"] = json!([64])), &[weight, "2 axes"]);
    expect(&Parts::of(&head).entry(weight, |e| e["shape"] = json!([8, 2, 4])), &[weight, "2 axes"]);
    expect(&Parts::of(&head).entry(weight, |e| e["shape"] = json!([4, 16])), &["layer1.linear1"]);
    expect(&Parts::of(&head).entry(weight, |e| e["shape"] = json!([64, 1])), &["layer1.linear1"]);
    expect(&Parts::of(&bake).entry("table.masses", |e| e["shape"] = json!([360])), &["table.masses", "4 axes"]);
    expect(&Parts::of(&bake).entry("table.masses", |e| e["shape"] = json!([1, 24, 3, 5])), &["normals", "1x24"]);
    expect(&Parts::of(&bake).entry("table.masses", |e| e["shape"] = json!([2, 2, 9, 10])), &["normals", "2x2"]);
    for shape in [json!([u64::MAX, 2]), json!([1_u64 << 32, 1_u64 << 32]), json!([0, 5]), json!([-1, 3]), json!([])] {
        expect(&Parts::of(&head).entry(weight, |e| e["shape"] = shape.clone()), &[""; 0]);
        expect(&Parts::of(&head).entry(luminance, |e| e["shape"] = shape.clone()), &[""; 0]);
    }
    for offsets in [json!([0, u64::MAX]), json!([u64::MAX, 0]), json!([8, 4]), json!([0]), json!("all")] {
        expect(&Parts::of(&head).entry(weight, |e| e["data_offsets"] = offsets.clone()), &["header"]);
    }
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        expect(&Parts::of(&head).values(weight, value), &["layer1.linear1", "not finite"]);
        expect(&Parts::of(&head).values("layer0.linear0.bias", value), &["layer0.linear0", "not finite"]);
        expect(&Parts::of(&head).values(luminance, value), &["luminance"]);
        expect(&Parts::of(&bake).values("table.masses", value), &["table"]);
    }
    expect(&Parts::of(&head).values(luminance, 0.0), &["luminance", "zero everywhere"]);
    expect(&Parts::of(&head).values(luminance, -1.0), &["luminance", "negative"]);
    expect(&Parts::of(&bake).values("table.masses", -1.0), &["table", "negative"]);
    // The length of the header itself.
    for length in [0, 1, 100_000_000_u64, u64::MAX] {
        expect(&[&length.to_le_bytes()[..], &head[8..]].concat(), &["header"]);
    }
}

#[test]
fn a_wrong_selection_network_is_refused_by_name() {
    let folder = Folder::new();
    let expect = |bytes: &[u8], words: &[&str]| {
        let error = folder.refused(bytes);
        words.iter().for_each(|word| assert!(error.contains(word), "{error}"));
    };
    for sampler in microfacet_samplers() {
        let bytes = folder.bytes_of(&sampler);
        let shaped = |name: &str, shape: Value| Parts::of(&bytes).entry(name, |entry| entry["shape"] = shape);
        // An equal number of values in another shape: the condition, then the encoder's five outputs, to 4
        // and on to 1.
        let seen = Parts::of(&bytes).header["selection.linear0.weight"]["shape"][1].as_u64().unwrap();
        expect(&shaped("selection.linear0.weight", json!([seen, 4])), &["selection.linear0"]);
        expect(&shaped("selection.linear0.weight", json!([2, 2 * seen])), &["selection.linear0"]);
        expect(&shaped("selection.linear0.weight", json!([4 * seen])), &["selection.linear0.weight", "2 axes"]);
        expect(&shaped("selection.linear1.weight", json!([4, 1])), &["selection.linear1"]);
        expect(&shaped("selection.linear1.bias", json!([1, 1])), &["selection.linear1.bias", "1 axes"]);
        expect(&Parts::of(&bytes).values("selection.linear0.weight", f32::NAN), &["selection.linear0", "not finite"]);

        let layers =
            |count: usize| Parts::of(&bytes).describe(|d| d["intermediate"]["selection_layers"] = json!(count));
        expect(&layers(0), &["selection.linear", "not known"]);
        expect(&layers(1), &["selection"]);
        expect(&layers(3), &["selection.linear2.weight", "missing"]);
        expect(&layers(usize::MAX), &["selection", "16"]);
    }
    // Layers of the shorter condition fit each other, but not the head.
    let [ggx, roughness] = [0, 1].map(|k| folder.bytes_of(&microfacet_samplers()[k]));
    let mut parts = Parts::of(&roughness);
    let other = Parts::of(&ggx);
    let range = |parts: &Parts, name: &str| {
        let offsets = &parts.header[name]["data_offsets"];
        offsets[0].as_u64().unwrap() as usize..offsets[1].as_u64().unwrap() as usize
    };
    let values = other.body[range(&other, "selection.linear0.weight")].to_vec();
    let own = range(&parts, "selection.linear0.weight");
    let cut = own.len() - values.len();
    parts.body.splice(own.clone(), values);
    parts.header["selection.linear0.weight"] = json!({
        "dtype": "F32", "shape": other.header["selection.linear0.weight"]["shape"],
        "data_offsets": [own.start, own.end - cut],
    });
    for (name, entry) in parts.header.as_object_mut().unwrap() {
        if name != "__metadata__" && entry["data_offsets"][0].as_u64().unwrap() as usize >= own.end {
            for k in 0..2 {
                entry["data_offsets"][k] = json!(entry["data_offsets"][k].as_u64().unwrap() as usize - cut);
            }
        }
    }
    expect(&parts.bytes(), &["selection", "17 numbers to one"]);
}

#[test]
fn extreme_weights_never_panic() {
    let folder = Folder::new();
    for sampler in [&samplers()[0], &samplers()[1], &samplers()[2], &samplers()[3]] {
        let bytes = folder.bytes_of(sampler);
        let names: Vec<String> = Parts::of(&bytes).header.as_object().unwrap().keys().cloned().collect();
        for name in names.iter().filter(|name| name.contains("linear")) {
            for value in [0.0, f32::MAX, -f32::MAX, 1e20, f32::MIN_POSITIVE, -1e3] {
                // Some values give no valid density and are rejected.
                if let Ok(read) = folder.read(&Parts::of(&bytes).values(name, value)) {
                    draws(&read, 50);
                }
            }
        }
    }
}

#[test]
fn files_other_than_samplers_are_refused() {
    let folder = Folder::new();
    assert!(folder.refused(b"").contains("not a sampler written by headtail"));
    assert!(folder.refused(b"# a text file\nwith two lines\n").contains("not a sampler written by headtail"));
    assert!(folder.refused(&[0; 4096]).contains("not a sampler written by headtail"));
    assert!(folder.refused(&[0xFF; 4096]).contains("not a sampler written by headtail"));
    // JSON nested deep enough to exhaust a recursive parser's stack.
    let deep = format!("{{\"a\":{}", "[".repeat(200_000));
    assert!(folder.refused(&[&(deep.len() as u64).to_le_bytes(), deep.as_bytes()].concat()).contains("header"));
    for path in [folder.0.path().to_owned(), folder.path("not there.safetensors")] {
        one_sentence(&ExportedSampler::read(&path).expect_err("accepted"), &path);
    }
}

#[test]
fn a_map_other_than_the_sampler_s_is_refused() {
    let folder = Folder::new();
    let path = folder.path("head.safetensors");
    samplers()[0].write(&path).unwrap();
    let spec = SamplerSpec::file(FileKind::Head, path.clone());
    spec.build(&environment("test map", 0)).unwrap();
    let other = environment("other map", 1);
    let error = one_sentence(&spec.build(&other).err().expect("accepted"), &path);
    for word in ["test map", "other map", "bake it for this map"] {
        assert!(error.contains(word), "{error}");
    }
    // The hash is of the map, but the tail is built from the luminance in the file, which must match the map:
    // where only the luminance is 0, light would be lost silently.
    let mut parts = Parts::of(&fs::read(&path).unwrap());
    let first = parts.header["tail.luminance"]["data_offsets"][0].as_u64().unwrap() as usize;
    parts.body[first + 160..first + 320].fill(0);
    fs::write(&path, parts.bytes()).unwrap();
    let error = one_sentence(&spec.build(&environment("test map", 0)).err().expect("accepted"), &path);
    assert!(error.contains("luminance"), "{error}");
}

#[test]
fn a_file_of_another_kind_is_refused_with_advice() {
    let folder = Folder::new();
    let map = environment("test map", 0);
    let path = |name: &str| folder.path(name);
    for (name, index) in [("head", 0), ("baked", 4), ("direct", 5)] {
        samplers()[index].write(&path(name)).unwrap();
    }
    let build = |kind: &str, name: &str| {
        let spec: SamplerSpec = format!("{kind}:{}", path(name).display()).parse().unwrap();
        spec.build(&map).map(drop).map_err(|error| one_sentence(&error, &path(name)))
    };
    for (kind, name, advice) in [
        ("baked", "head", "head:FILE"),
        ("direct", "head", "head:FILE"),
        ("head", "baked", "baked:FILE"),
        ("direct", "baked", "baked:FILE"),
        ("head", "direct", "direct:FILE"),
        ("baked", "direct", "direct:FILE"),
    ] {
        let error = build(kind, name).unwrap_err();
        assert!(error.contains(advice), "{kind}:{name}: {error}");
    }
    for kind in ["head", "baked", "direct"] {
        build(kind, kind).unwrap();
    }
}

#[test]
fn a_file_that_cannot_be_read_back_is_not_written() {
    let folder = Folder::new();
    let path = folder.path("diverged.safetensors");
    for broken in [f64::NAN, f64::INFINITY] {
        let mut sampler = samplers().swap_remove(0);
        sampler.training.as_mut().unwrap().final_kl = broken;
        let error = one_sentence(&sampler.write(&path).unwrap_err(), &path);
        assert!(error.contains("final_kl"), "{error}");
        assert!(!path.exists());
    }
}

#[test]
fn a_condition_of_the_wrong_length_is_an_error() {
    for condition in [Condition::Normal, Condition::Ggx, Condition::GgxRoughness] {
        let head = head_of(condition, Mode::Coupled, true, true);
        let right = condition.length();
        assert!(head.at(&vec![0.5; right]).is_ok());
        for length in [0, 1, right - 1, right + 1, 1000] {
            let error = head.at(&vec![0.5; length]).expect_err("accepted").to_string();
            let words = ["condition", &format!("{length} numbers"), &format!("takes {right}")];
            assert!(words.iter().all(|word| error.contains(word)) && !error.contains('\n'), "{error}");
        }
    }
}
