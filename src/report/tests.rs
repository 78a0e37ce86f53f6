use super::*;

#[test]
fn files_and_figures_are_written_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    Report::new(folder.path()).finish(&synthetic::comparison()).unwrap();
    let mut names: Vec<String> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names, ["figures", "report.html", "results.csv"]);
    let charts = ["error-time", "ratios", "speed-accuracy", "pictures"];
    let charts = charts.iter().flat_map(|name| [format!("{name}.svg")]);
    for name in charts.chain(["results.tex", "results.csv"].map(String::from)) {
        assert!(folder.path().join("figures").join(&name).metadata().unwrap().len() > 400, "{name}");
    }
    assert!(Report::new(&folder.path().join("missing")).finish(&synthetic::comparison()).is_err());
}

#[test]
fn the_same_comparison_gives_the_same_bytes() {
    let page = || {
        let comparison = synthetic::comparison();
        let summary = summary::Summary::of(&comparison.rows).unwrap();
        html::page(&comparison, &summary, &mut gallery::Gallery::default()).unwrap()
    };
    assert_eq!(page(), page());
}

#[test]
fn a_report_that_grew_run_by_run_is_the_one_of_all_runs() {
    let [grown, whole] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let mut comparison = synthetic::comparison();
    let (rows, images) = (std::mem::take(&mut comparison.rows), std::mem::take(&mut comparison.images));
    let mut report = Report::new(grown.path());
    for row in rows {
        let image = images.iter().find(|i| i.sampler == row.sampler && i.budget == row.budget && row.run == 0);
        comparison.images.extend(image.map(|image| RenderedImage {
            sampler: image.sampler.clone(),
            budget: image.budget.clone(),
            image: image.image.clone(),
        }));
        comparison.rows.push(row);
        report.update_table(&comparison).unwrap();
        report.update_page(&comparison).unwrap();
    }
    report.finish(&comparison).unwrap();
    Report::new(whole.path()).finish(&comparison).unwrap();
    for name in ["results.csv", "report.html"] {
        let read = |folder: &tempfile::TempDir| std::fs::read_to_string(folder.path().join(name)).unwrap();
        assert!(read(&grown) == read(&whole), "{name}");
    }
}

#[test]
fn slow_reports_are_written_less_often() {
    let mut pace = Pace::default();
    assert!(pace.is_due());
    pace.wrote(Duration::from_millis(1));
    assert!(pace.is_due());
    pace.wrote(Duration::from_secs(1000));
    assert!(!pace.is_due());
}
