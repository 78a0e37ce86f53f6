//! The outputs of `compare`.

use std::fs;

use super::{SMALL, fail, folder, mean, names, picture, succeed};

#[test]
fn compare_writes_the_table_the_page_and_the_images() {
    let here = folder();
    let path = here.path();
    succeed(path, "bake --direct --env studio --normals 6x8 --cells 8x8 --out direct.safetensors");
    let samplers = ["mis", "ris:2", "direct:direct.safetensors"];
    let view = format!("compare --scene sphere --env studio {SMALL} --reference-spp 32");
    let said = succeed(
        path,
        &format!("{view} --samplers {} --spp 2,4 --seconds 0.05 --runs 2 --seed 5 --out results", samplers.join(",")),
    );
    assert!(said.trim_end().ends_with("report.html"), "{said}");

    let mut reader = csv::Reader::from_path(path.join("results/results.csv")).unwrap();
    let columns = "scene,env,sampler,budget,run,spp,rays_per_sample,seconds,mse,relmse,relmse_trimmed,ttuv,mean_luminance,max_weight,seed,version,points";
    assert_eq!(reader.headers().unwrap().iter().collect::<Vec<_>>().join(","), columns);
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 3 * 3 * (2 + 1));
    for sampler in samplers {
        for budget in ["2spp", "4spp", "0.05s"] {
            let group: Vec<_> = rows.iter().filter(|row| &row[2] == sampler && &row[3] == budget).collect();
            assert_eq!(group.iter().map(|row| &row[4]).collect::<Vec<_>>(), ["0", "1", "mean"], "{sampler} {budget}");
            assert_eq!((&group[0][14], &group[1][14]), ("5", "6"));
            assert!(
                group
                    .iter()
                    .all(|row| &row[0] == "sphere" && &row[1] == "studio" && &row[15] == env!("CARGO_PKG_VERSION"))
            );
            for column in 5..14 {
                let value = |row: usize| group[row][column].parse::<f64>().unwrap();
                assert!(value(0) > 0.0 && value(0).is_finite());
                // The mean row has the maximum of the largest weights, and means of all other columns.
                let expected = if column == 13 { value(0).max(value(1)) } else { 0.5 * (value(0) + value(1)) };
                assert!((value(2) / expected - 1.0).abs() < 1e-9, "{sampler} {budget} column {column}: {group:?}");
            }
        }
    }

    let page = fs::read_to_string(path.join("results/report.html")).unwrap();
    assert!(page.contains("data:image/png;base64,") && page.contains("<svg"));
    assert!(!page.contains("src=\"http") && !page.contains("href=\"http"), "the page needs nothing but itself");
    let images = names(&path.join("results"));
    assert_eq!(images.iter().filter(|name| name.ends_with(".exr")).count(), 1 + 2 * 3 * 3, "{images:?}");
    let errors = picture(&path.join("results/mis_2spp_error.exr"));
    assert!(mean(&errors) > 0.0 && errors.pixels.len() == 24 * 18);

    // An existing reference is reused; one of another size is rejected.
    let again = format!("{view} --samplers mis --spp 2 --runs 1 --reference results/reference.exr --out again");
    succeed(path, &again);

    // A cached reference is not rendered again and yields the same rows except for the seconds.
    let cached = format!("{view} --samplers mis --spp 2 --runs 1 --reference-cache cache --out");
    succeed(path, &format!("{cached} first"));
    succeed(path, &format!("{cached} second"));
    assert_eq!(names(&path.join("cache")).len(), 2);
    let mse = |folder: &str| fs::read_to_string(path.join(folder).join("results.csv")).unwrap();
    let mse = |folder: &str| mse(folder).lines().nth(1).unwrap().split(',').nth(8).unwrap().to_owned();
    assert_eq!(mse("first"), mse("second"));
    assert!(fs::read_to_string(path.join("second/report.html")).unwrap().contains("found in the cache"));
    succeed(path, &format!("{cached} third --seed 9"));
    assert_eq!(names(&path.join("cache")).len(), 4);

    let other_size = again.replace("--width 24", "--width 25");
    assert!(fail(path, &other_size).contains("24 x 18"));

    let away = format!("{view} --look-from 0,5,0 --look-at 0,9,0 --samplers mis --spp 1 --runs 1 --out away");
    assert!(fail(path, &away).contains("no pixel is covered by a surface"));
}
