use super::super::synthetic;
use headtail_eval::Measurement;

use super::super::{comparison::Comparison, number::times, summary::Measure};
use super::*;

fn page_of(comparison: &Comparison) -> String {
    page(comparison, &Summary::of(&comparison.rows).unwrap(), &mut Gallery::default()).unwrap()
}

/// All values of an attribute.
fn values<'a>(page: &'a str, attribute: &str) -> Vec<&'a str> {
    let starts = page.match_indices(attribute).map(|(at, _)| at + attribute.len());
    starts.map(|start| &page[start..start + page[start..].find('"').unwrap()]).collect()
}

#[test]
fn the_page_loads_no_external_resources() {
    let page = page_of(&synthetic::comparison());
    assert!(values(&page, " src=\"").iter().all(|address| address.starts_with("data:image/png;base64,")));
    assert!(values(&page, " href=\"").iter().all(|address| address.starts_with("data:") || address.starts_with('#')));
    assert!(
        !page.contains("//www") && !page.contains("http:") && !page.contains("https:") && !page.contains("@import")
    );
}

#[test]
fn every_choice_of_the_slider_has_its_image_and_each_is_embedded_once() {
    let comparison = synthetic::comparison();
    let page = page_of(&comparison);
    let ids = values(&page, " id=\"");
    let choices: Vec<&str> =
        values(&page, "<option value=\"").into_iter().filter(|id| id.starts_with("image")).collect();
    assert_eq!(choices.len(), 2 * (comparison.images.len() + 1));
    for choice in choices {
        assert_eq!(ids.iter().filter(|id| **id == choice).count(), 1, "{choice}");
    }
    let sources = values(&page, " src=\"");
    assert_eq!(sources.len(), 3 * comparison.images.len() + 1, "rendering, error and FLIP");
}

#[test]
fn names_are_escaped_as_text() {
    let evil = "<script>alert('x')</script>\"onload=";
    let mut comparison = synthetic::comparison();
    (comparison.scene, comparison.env) = (evil.into(), evil.into());
    (comparison.command, comparison.machine, comparison.version) = (evil.into(), evil.into(), evil.into());
    comparison.reference_note = evil.into();
    for row in &mut comparison.rows {
        (row.sampler, row.budget) = (format!("{evil}{}", row.sampler), format!("{evil}{}", row.budget));
    }
    for image in &mut comparison.images {
        (image.sampler, image.budget) = (format!("{evil}{}", image.sampler), format!("{evil}{}", image.budget));
    }
    for preparation in &mut comparison.preparation {
        (preparation.sampler, preparation.text) = (evil.into(), evil.into());
    }
    let page = page_of(&comparison);
    assert_eq!(page.matches("<script>").count(), 1, "the page's own");
    assert!(!page.contains("\"onload=") && !page.contains("<script>alert"));
}

#[test]
fn the_lowest_error_of_each_budget_is_marked() {
    let comparison = synthetic::comparison();
    let page = page_of(&comparison);
    // Four budgets with six measures: MSE, relMSE, trimmed relMSE, FLIP, HDR-FLIP and TTUV.
    assert_eq!(page.matches("class=\"number best\"").count(), 24);
}

#[test]
fn minimal_comparisons_produce_a_page() {
    let complete = synthetic::comparison();
    let poor = |rows: Vec<Measurement>| Comparison {
        rows,
        images: Vec::new(),
        preparation: Vec::new(),
        ..synthetic::comparison()
    };
    let broken = Measurement { mse: f64::NAN, relmse: f64::INFINITY, seconds: 0.0, ..synthetic::row("mis", "odd", 0) };
    for rows in [vec![synthetic::row("mis", "4spp", 0)], vec![broken], complete.rows[..3].to_vec()] {
        let page = page_of(&poor(rows));
        assert!(page.contains("All numbers") && !page.contains("id=\"slider\""));
        let drawings = page.split("<svg").skip(1).map(|rest| &rest[..rest.find("</svg>").unwrap()]);
        assert!(drawings.into_iter().all(|svg| !svg.contains("NaN") && !svg.contains("inf")));
    }
}

#[test]
fn missing_runs_are_reported_with_the_count_of_each_row() {
    let mut comparison = synthetic::comparison();
    assert!(!page_of(&comparison).contains("class=\"incomplete\""));
    comparison.rows.truncate(82);
    for (state, words) in [
        (State::Running { planned: 84 }, "was running when the page was written: 82 of 84 runs are done"),
        (State::Interrupted { planned: 84 }, "was interrupted: 82 of 84 runs are done"),
    ] {
        comparison.state = state;
        let page = page_of(&comparison);
        assert!(page.contains(words) && page.contains("<li>1 to 3 runs each</li>"), "{words}");
        let cells = |budget: &str, runs: u32| {
            page.matches(&format!("{budget}</td><td class=\"number\" data-value=\"{runs}\">{runs}</td>")).count()
        };
        assert_eq!((cells("spp", 3), cells("2s", 3), cells("2s", 1)), (21, 6, 1));
    }
}

#[test]
fn tests_are_paired_and_ratios_have_intervals() {
    let page = page_of(&synthetic::comparison());
    assert!(page.contains("paired t-test") && !page.contains("Welch"));
    let summary = Summary::of(&synthetic::comparison().rows).unwrap();
    for group in summary.groups.iter().filter(|group| group.sampler != summary.baseline) {
        let (low, high) = summary.ratio(group, Measure::Mse).unwrap().ends().unwrap();
        assert!(page.contains(&format!("<span class=\"ci\">{} to {}</span>", times(low), times(high))));
    }
}

#[test]
fn the_oracle_is_explained_where_it_is_shown() {
    let mut comparison = synthetic::comparison();
    assert!(!page_of(&comparison).contains("without visibility"));
    comparison.rows.push(synthetic::row("oracle", "4spp", 0));
    assert!(page_of(&comparison).contains("exact product of light, BRDF and cosine, without visibility"));
}

#[test]
fn images_of_another_size_are_refused() {
    let mut comparison = synthetic::comparison();
    comparison.images[3].image = headtail_render::image::Image::black(3, 3);
    let summary = Summary::of(&comparison.rows).unwrap();
    assert!(page(&comparison, &summary, &mut Gallery::default()).is_err());
}
