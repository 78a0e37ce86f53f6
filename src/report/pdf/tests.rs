use std::io::Read;

use super::super::{html, synthetic};
use super::*;

/// What is drawn on the page.
fn content(pdf: &[u8]) -> String {
    let find = |from: usize, what: &[u8]| from + pdf[from..].windows(what.len()).position(|w| w == what).unwrap();
    let start = find(find(0, b"4 0 obj"), b"stream\n") + 7;
    let mut text = String::new();
    flate2::read::ZlibDecoder::new(&pdf[start..]).read_to_string(&mut text).unwrap();
    text
}

fn svg(body: &str) -> String {
    let style = ".chart text { fill: #112233; } .small, .chart .b { font-size: 10px; } .s1 { color: #ff0000; } \
                 .line { fill: none; stroke: currentColor; } .v1 .line { stroke-dasharray: 7 3; opacity: .5; }";
    format!("<svg xmlns=\"x\" class=\"chart\" width=\"200\" height=\"100\"><style>{style}</style>{body}</svg>\n")
}

#[test]
fn every_drawing_of_a_report_is_understood() {
    let comparison = synthetic::comparison();
    let summary = super::super::summary::Summary::of(&comparison.rows).unwrap();
    let mut gallery = super::super::gallery::Gallery::default();
    gallery.update(&comparison, &summary).unwrap();
    let (mut charts, _) = html::figures(&comparison, &summary, &gallery);
    charts.push(super::super::teaser::teaser(&comparison, &summary, 0.0).unwrap());
    for chart in charts {
        let file = pdf(&chart.widest().unwrap().file()).unwrap();
        assert!(file.starts_with(b"%PDF-1.4") && file.ends_with(b"%%EOF\n") && content(&file).contains(" Tj"));
    }
}

#[test]
fn objects_are_where_the_table_says() {
    let file = pdf(&svg("<rect x=\"1\" y=\"2\" width=\"3\" height=\"4\" fill=\"#fff\"/>")).unwrap();
    let at = |place: usize| String::from_utf8_lossy(&file[place..]).into_owned();
    let text = String::from_utf8_lossy(&file);
    let table: usize = text.rsplit("startxref\n").next().unwrap().lines().next().unwrap().parse().unwrap();
    let entries: Vec<usize> =
        at(table).lines().skip(3).map_while(|line| line.split(' ').next()?.parse().ok()).collect();
    assert_eq!(entries.len(), 7);
    for (k, &place) in entries.iter().enumerate() {
        assert!(at(place).starts_with(&format!("{} 0 obj", k + 1)), "{k}");
    }
}

#[test]
fn styles_come_from_the_most_specific_rule_and_from_outside() {
    let page = |body: &str| content(&pdf(&svg(body)).unwrap());
    let line = page("<g class=\"s1 v1\"><path class=\"line\" d=\"M1 2L3 4h5v-1Z\"/></g>");
    assert!(
        line.contains("1.000 0.000 0.000 RG [7 3] 0 d")
            && line.contains("3.00 4.00 l\n8.00 4.00 l\n8.00 3.00 l\nh\nS Q"),
        "{line}"
    );
    // A class outranks a name, and outside of any group there is no colour but black.
    let text = page("<text class=\"b\" x=\"10\" y=\"20\" text-anchor=\"end\">ab</text>");
    assert!(
        text.contains("/F1 10 Tf 1 0 0 -1 -11.12 0.00 Tm <6162> Tj") && text.contains("0.067 0.133 0.200 rg"),
        "{text}"
    );
    assert!(page("<path class=\"line\" d=\"M0 0H9\"/>").contains("0.000 0.000 0.000 RG [] 0 d"));
}

#[test]
fn letters_that_no_font_has_are_written_as_their_numbers() {
    let page = |words: &str| content(&pdf(&svg(&format!("<text x=\"0\" y=\"0\">{words}</text>"))).unwrap());
    // Times sign and raised minus.
    let power = page("5\u{d7}10<tspan dy=\"-5\" font-size=\"9.5\">\u{2212}4</tspan>");
    assert!(
        power.contains("<35d73130> Tj") && power.contains("/F3 9.5 Tf") && power.contains("-5.00 Tm <2d> Tj"),
        "{power}"
    );
    assert!(page("a &lt; \u{e9}").contains("<61203c20e9> Tj"));
    let number: String = "\\u{65e5}".bytes().map(|byte| format!("{byte:02x}")).collect();
    assert!(page("\u{65e5}").contains(&number));
}

#[test]
fn what_is_not_understood_is_refused() {
    for body in [
        "<ellipse/>",
        "<path d=\"M0 0C1 2 3 4 5 6\"/>",
        "<g>",
        "words",
        "<path class=\"line\" d=\"M1 2a3 4 0 1 0 5 6\"/>",
    ] {
        assert!(pdf(&svg(body)).is_err(), "{body}");
    }
    assert!(pdf("<svg>").is_err());
}
