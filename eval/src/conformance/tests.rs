use std::f32::consts::PI;

use glam::Vec2;
use headtail_render::latlong;

use super::{kit::write_answers, *};

/// Answers of an implementation: that of a map, modified.
fn verdicts(map: &Arc<Environment>, fault: impl Fn(&Row, &mut Answer)) -> Vec<Verdict> {
    let folder = tempfile::tempdir().unwrap();
    let correct = cases(&super::map().unwrap()).unwrap();
    for (case, own) in correct.iter().zip(cases(map).unwrap()) {
        let rows = case.rows().unwrap();
        let mut answers = own.answers(&rows).unwrap();
        rows.iter().zip(&mut answers).for_each(|(row, answer)| fault(row, answer));
        write_answers(folder.path(), case.name, &answers).unwrap();
    }
    check(folder.path()).unwrap()
}

/// The map with its columns rearranged.
fn rearranged(column: impl Fn(usize) -> usize) -> Arc<Environment> {
    let image = map().unwrap().to_image();
    let texel = |k: usize| image.pixels[k / WIDTH * WIDTH + column(k % WIDTH) % WIDTH];
    let pixels = (0..WIDTH * HEIGHT).map(texel).collect();
    Arc::new(Environment::from_image("rearranged", Image { width: WIDTH, height: HEIGHT, pixels }).unwrap())
}

fn emitters_fault(verdicts: &[Verdict]) -> &str {
    assert!(verdicts[0].name == "emitter" && !verdicts[0].passed(), "{}", verdicts[0]);
    &verdicts[0].faults[0]
}

#[test]
fn correct_answers_pass() {
    let verdicts = verdicts(&map().unwrap(), |_, _| {});
    let names = ["emitter", "patches", "patches-glossy", "table", "mis-glossy"];
    assert_eq!(verdicts.iter().map(|verdict| verdict.name).collect::<Vec<_>>(), names);
    for verdict in &verdicts {
        println!("{verdict}");
        // The pdf of a rounded direction differs at borders.
        assert!(verdict.passed() && verdict.wrong_pdfs == 0.0 && verdict.other_directions == 0.0, "{verdict}");
    }
}

#[test]
fn another_warp_with_the_same_density_passes() {
    let map = map().unwrap();
    let (cases, folder) = (cases(&map).unwrap(), tempfile::tempdir().unwrap());
    for case in &cases {
        let rows = case.rows().unwrap();
        let mut random = Stream::new(5, Purpose::Test, 0);
        let others: Vec<Row> = rows.iter().map(|row| Row { u: random.uniform2(), ..*row }).collect();
        write_answers(folder.path(), case.name, &case.answers(&others).unwrap()).unwrap();
    }
    for verdict in check(folder.path()).unwrap() {
        assert!(verdict.passed() && verdict.other_directions > 0.5, "{verdict}");
    }
}

#[test]
fn rearranged_maps_are_named() {
    // Both kinds of mirror differ by a turn.
    let mirrored = verdicts(&rearranged(|column| WIDTH - 1 - column), |_, _| {});
    assert!(emitters_fault(&mirrored).contains("azimuth runs the other way"), "{}", mirrored[0]);
    let turned = verdicts(&rearranged(|column| column + WIDTH / 4), |_, _| {});
    assert!(emitters_fault(&turned).contains("turned by"), "{}", turned[0]);
    assert!(turned.iter().all(|verdict| !verdict.passed()));
    let shifted = verdicts(&rearranged(|column| column + 1), |_, _| {});
    assert!(emitters_fault(&shifted).contains("a texel too far left"), "{}", shifted[0]);
}

#[test]
fn half_a_texel_is_named() {
    let map = map().unwrap();
    let emitter = &cases(&map).unwrap()[0];
    // Texel centres at column / width: the density at u is that of the map at u + 0.5 / width.
    let shifted = verdicts(&map, |row, answer| {
        let x = latlong::square(row.given);
        let given = latlong::direction(Vec2::new((x.x + 0.5 / WIDTH as f32).fract(), x.y));
        answer.pdf_of_given = emitter.pdfs(&[Row { given, ..*row }]).unwrap()[0];
    });
    assert!(emitters_fault(&shifted).contains("half a texel too far left"), "{}", shifted[0]);
}

#[test]
fn other_axes_are_named() {
    let map = map().unwrap();
    let emitter = &cases(&map).unwrap()[0];
    let other = |in_map: &dyn Fn(Vec3A) -> Vec3A, words: &str| {
        let other = verdicts(&map, |row, answer| {
            let row = Row { given: in_map(row.given), ..*row };
            answer.pdf_of_given = emitter.pdfs(&[row]).unwrap()[0];
        });
        assert!(emitters_fault(&other).contains(words), "{}", other[0]);
    };
    other(&|w| Vec3A::new(w.x, w.z, -w.y), "the vertical axis is z, not y");
    other(&|w| Vec3A::new(w.x, -w.y, w.z), "upside down");
}

#[test]
fn densities_without_sine_are_named() {
    let no_sine = verdicts(&map().unwrap(), |row, answer| answer.pdf_of_given *= sine(row.given));
    for verdict in &no_sine {
        assert!(verdict.faults[0].contains("lacks the sine"), "{verdict}");
    }
    let over_square = verdicts(&map().unwrap(), |row, answer| {
        answer.pdf_of_given *= 2.0 * PI * PI * sine(row.given);
        answer.pdf *= 2.0 * PI * PI * sine(answer.wi);
    });
    assert!(emitters_fault(&over_square).contains("over the map's square"));
    assert!(over_square[0].faults[1].contains("their pdf is not that of their direction"), "{}", over_square[0]);
}

#[test]
fn wrong_cells_at_the_pole_are_named() {
    // The cell of the lowest row instead of that of the pole: other light, by a factor.
    let wrong = verdicts(&map().unwrap(), |row, answer| {
        if sine(row.given) < (PI / (HEIGHT - 1) as f32).sin() {
            answer.pdf_of_given *= 1.3;
        }
    });
    assert!(emitters_fault(&wrong).contains("beside a pole"), "{}", wrong[0]);
}

#[test]
fn draws_of_another_density_are_found() {
    // Draws of the emitter for patches, with the pdfs of patches.
    let map = map().unwrap();
    let (cases, folder) = (cases(&map).unwrap(), tempfile::tempdir().unwrap());
    let rows = cases[1].rows().unwrap();
    let mut answers = cases[0].answers(&rows).unwrap();
    let drawn: Vec<Row> = rows.iter().zip(&answers).map(|(row, answer)| Row { given: answer.wi, ..*row }).collect();
    let pdfs = cases[1].pdfs(&drawn).unwrap();
    for ((answer, row), pdf) in answers.iter_mut().zip(&rows).zip(pdfs) {
        (answer.pdf, answer.pdf_of_given) = (pdf, row.answer.pdf_of_given);
    }
    write_answers(folder.path(), "patches", &answers).unwrap();
    let verdicts = check(folder.path()).unwrap();
    assert!(verdicts.len() == 1 && verdicts[0].wrong_pdfs == 0.0, "{}", verdicts[0]);
    assert!(verdicts[0].faults[0].contains("do not follow the pdf"), "{}", verdicts[0]);
}

#[test]
fn hostile_answers_are_errors_or_wrong() {
    let folder = tempfile::tempdir().unwrap();
    assert!(check(folder.path()).unwrap_err().to_string().contains("has no answers"));
    std::fs::write(folder.path().join("table.answers.f32"), [0; 12]).unwrap();
    assert!(check(folder.path()).unwrap_err().to_string().contains("has 12 bytes"));
    for value in [f32::NAN, f32::INFINITY, -1.0, 0.0] {
        let answer = Answer { wi: Vec3A::splat(value), pdf: value, pdf_of_given: value };
        write_answers(folder.path(), "table", &vec![answer; POINTS * ROWS]).unwrap();
        let verdicts = check(folder.path()).unwrap();
        assert!(!verdicts[0].passed(), "{value}: {}", verdicts[0]);
    }
}

#[test]
fn a_kit_has_the_files_that_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    write_kit(folder.path()).unwrap();
    let mut found: Vec<String> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|file| file.unwrap().file_name().into_string().unwrap())
        .collect();
    let mut listed = kit_files().unwrap();
    found.sort();
    listed.sort();
    assert_eq!(found, listed);
}
