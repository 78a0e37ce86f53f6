//! Parsing and printing.

use super::*;

#[test]
fn specifications_print_as_they_parse() {
    for text in [
        "auto",
        "brdf",
        "cosine",
        "emitter",
        "mis",
        "mis2",
        "mis-comp",
        "mis2-comp",
        "split:2:mis2",
        "split:4:mis2-comp",
        "split:4:mis2:patches",
        "ris:4",
        "head:a/b.safetensors",
        "baked:x:y",
        "head+mis:a",
        "direct+mis:b:c",
        "ris:4:head:a",
        "ris:16:direct:b:c",
        "oracle",
        "oracle+mis",
        "patches",
        "patches:fine",
        "patches+vis",
        "patches:fine+vis",
        "patches+vis:a/b:c",
        "patches:fine+vis:a",
        "head:a+vis:b",
        "head:a+vis",
        "head+patches:a/b:c",
        "head+patches:a+vis",
        "head+patches+vis:a/b:c",
        "head+patches+vis@a:b:c",
        "direct:a+vis:b",
        "ris:4:head+patches:a",
        "mis2:head+patches:a",
        "ris:4:patches",
        "mis2:direct:a",
        "split:2:patches",
        "split:64:head+mis:a:b",
        "split:2:head+patches+vis@a:b",
        "mis2:head+mis:a",
        "neusample:a",
        "reparam+emitter:a:b",
        "split:4:mis-comp",
        "split:4:patches+vis",
        "split:2:patches:fine+vis:a/b:c",
        "ris:4:head+mis:a",
        "ris:4:mis",
        "portals",
        "portals+mis:a:b",
        "mis2:portals",
        "mis2:portals:a",
        "split:4:portals+mis",
    ] {
        assert_eq!(text.parse::<SamplerSpec>().unwrap().to_string(), text);
    }
}

#[test]
fn errors_name_the_invalid_specification() {
    for text in [
        "",
        "ris",
        "ris:0",
        "ris:x",
        "head",
        "head:",
        "mis:4",
        "brdf:1",
        "best",
        "mis+mis:a",
        "patches:coarse",
        "patches+mis",
        "patches:fine+mis",
        "patches+mis:fine",
        "patches:finest",
        "mis+vis",
        "portals:",
        "portals+emitter",
        "portals+vis",
        "direct+vis:a",
        "head+vis:a",
        "baked+mis+vis@a:b",
        "head+patches+vis@:a",
        "head+patches+vis@a",
        "ris:4+vis",
        "mis2:patches+vis",
        "mis2:mis2",
        "mis2:mis2-comp",
        "ris:4:mis2",
        "mis2-comp:a",
        "ris:4:mis2-comp",
        "split:2:split:2:patches",
        "split:2:ris:4",
        "split:2:auto",
        "auto+vis",
        "auto:a",
        "brdf+mis",
        "neusample+mis:a",
        "neusample",
        "head+emitter:a",
        "split:65:patches+vis",
        "direct+visual:a",
        "patches+vis8",
        "patches+vis@a",
        "patches+visual",
        "head+patches+vis8:a",
        "mis+vis:a",
        "patches+vis:",
        "head+patches",
        "head+patches+vis",
        "head+patches+vis:",
        "head+patches+mis:a",
        "ris:4:patches+vis",
        "head+mis",
        "ris:4:head",
        "ris:4:mis:x",
        "split",
        "split:2",
        "split:0:mis",
        "split:65:mis",
        "split:2:",
        "split:2:split:2:mis",
    ] {
        let error = text.parse::<SamplerSpec>().unwrap_err().to_string();
        assert!(error.contains(&format!("'{text}'")), "{error}");
    }
}

#[test]
fn every_form_in_the_help_parses() {
    for form in forms::forms() {
        let text = form.form.replace("SOURCE", "mis").replace("split:N", "split:4").replace("ris:M", "ris:4");
        let spec: SamplerSpec = text.parse().unwrap();
        assert_eq!(spec.to_string(), text);
    }
    let error = "magic".parse::<SamplerSpec>().unwrap_err().to_string();
    assert!(error.contains("is not one of auto, patches, patches:fine"), "{error}");
}
