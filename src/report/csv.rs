//! `results.csv`: every run and the means, in full precision.

use anyhow::{Context, Result, ensure};

use super::summary::Summary;
use headtail_eval::Measurement;

/// The columns in order.
const COLUMNS: [&str; 17] = [
    "scene",
    "env",
    "sampler",
    "budget",
    "run",
    "spp",
    "rays_per_sample",
    "seconds",
    "mse",
    "relmse",
    "relmse_trimmed",
    "ttuv",
    "mean_luminance",
    "max_weight",
    "seed",
    "version",
    "points",
];

/// Point set of runs in files without that column.
const OLD_POINTS: &str = "independent";

/// Encodes the file: for each sampler at each budget its runs, then the row of means, whose `run` is `mean`.
pub fn encode(rows: &[Measurement], summary: &Summary) -> Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(COLUMNS)?;
    for group in &summary.groups {
        let of_group = |row: &&Measurement| row.sampler == group.sampler && row.budget == group.budget;
        for row in rows.iter().filter(of_group) {
            writer.write_record(record(row, &row.run.to_string()))?;
        }
        writer.write_record(record(&group.mean, "mean"))?;
    }
    Ok(writer.into_inner()?)
}

/// Decodes the runs, without rows of means. The column of points may be missing.
pub fn decode(bytes: &[u8]) -> Result<Vec<Measurement>> {
    let mut reader = csv::Reader::from_reader(bytes);
    let headers = reader.headers()?;
    let known = headers.iter().eq(COLUMNS) || headers.iter().eq(COLUMNS[..16].iter().copied());
    ensure!(known, "the columns are not those of results.csv: {}", COLUMNS.join(","));
    let mut rows = Vec::new();
    for (index, record) in reader.records().enumerate() {
        let record = record?;
        let number = |column: usize| -> Result<f64> {
            record[column].parse().with_context(|| format!("row {}: {} is not a number", index + 1, COLUMNS[column]))
        };
        if &record[4] == "mean" {
            continue;
        }
        rows.push(Measurement {
            scene: record[0].to_owned(),
            env: record[1].to_owned(),
            sampler: record[2].to_owned(),
            budget: record[3].to_owned(),
            run: number(4)? as u32,
            spp: number(5)?,
            rays_per_sample: number(6)?,
            seconds: number(7)?,
            mse: number(8)?,
            relmse: number(9)?,
            relmse_trimmed: number(10)?,
            ttuv: number(11)?,
            mean_luminance: number(12)?,
            max_weight: number(13)?,
            seed: record[14].parse().with_context(|| format!("row {}: seed is not a number", index + 1))?,
            version: record[15].to_owned(),
            points: record.get(16).unwrap_or(OLD_POINTS).to_owned(),
            ..Measurement::unknown()
        });
    }
    Ok(rows)
}

/// Floats are the shortest decimals that parse to the same bits.
fn record(row: &Measurement, run: &str) -> [String; 17] {
    [
        row.scene.clone(),
        row.env.clone(),
        row.sampler.clone(),
        row.budget.clone(),
        run.to_owned(),
        row.spp.to_string(),
        row.rays_per_sample.to_string(),
        row.seconds.to_string(),
        row.mse.to_string(),
        row.relmse.to_string(),
        row.relmse_trimmed.to_string(),
        row.ttuv.to_string(),
        row.mean_luminance.to_string(),
        row.max_weight.to_string(),
        row.seed.to_string(),
        row.version.clone(),
        row.points.clone(),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::synthetic;
    use super::*;

    #[test]
    fn runs_and_means_round_trip_exactly() {
        let comparison = synthetic::comparison();
        let summary = Summary::of(&comparison.rows).unwrap();
        let bytes = encode(&comparison.rows, &summary).unwrap();
        let text = String::from_utf8(bytes.clone()).unwrap();
        assert!(text.starts_with(
            "scene,env,sampler,budget,run,spp,rays_per_sample,seconds,mse,relmse,relmse_trimmed,ttuv,mean_luminance,\
             max_weight,seed,version,points\n"
        ));
        let mut reader = csv::Reader::from_reader(bytes.as_slice());
        let records: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        assert_eq!(records.len(), comparison.rows.len() + summary.groups.len());
        assert_eq!(records.iter().filter(|record| &record[4] == "mean").count(), summary.groups.len());
        for row in &comparison.rows {
            let found = records.iter().any(|record| {
                record[2] == row.sampler
                    && record[3] == row.budget
                    && record[4] == *row.run.to_string()
                    && record[8].parse::<f64>().unwrap().to_bits() == row.mse.to_bits()
                    && record[14].parse::<u64>().unwrap() == row.seed
            });
            assert!(found, "{row:?}");
        }
    }

    #[test]
    fn written_files_are_read_and_damage_is_named() {
        let comparison = synthetic::comparison();
        let bytes = encode(&comparison.rows, &Summary::of(&comparison.rows).unwrap()).unwrap();
        let mut rows = decode(&bytes).unwrap();
        let mut expected = comparison.rows;
        for rows in [&mut rows, &mut expected] {
            rows.sort_by_key(|row| (row.sampler.clone(), row.budget.clone(), row.run));
        }
        // Fields without a column are NaN.
        assert_eq!(format!("{rows:?}"), format!("{expected:?}"));
        let text = String::from_utf8(bytes).unwrap();
        let damaged = |from: &str, to: &str| decode(text.replacen(from, to, 1).as_bytes()).unwrap_err().to_string();
        assert!(damaged("scene,", "place,").contains("the columns are not"));
        let mse = comparison_mse(&text);
        assert!(damaged(&mse, "much").contains("row 1: mse is not a number"), "{}", damaged(&mse, "much"));
        assert!(decode(b"").is_err() && decode(&text.as_bytes()[..text.len() / 2]).is_err());
    }

    #[test]
    fn files_without_points_default_to_independent() {
        let rows = [synthetic::row("mis", "4spp", 0), synthetic::row("mis", "4spp", 1)];
        let text = String::from_utf8(encode(&rows, &Summary::of(&rows).unwrap()).unwrap()).unwrap();
        let old: String = text.lines().map(|line| line.rsplit_once(',').unwrap().0.to_owned() + "\n").collect();
        let expected = rows.map(|row| Measurement { points: "independent".into(), ..row });
        assert_eq!(format!("{:?}", decode(old.as_bytes()).unwrap()), format!("{:?}", expected.to_vec()));
    }

    /// The MSE of the first run as it is written.
    fn comparison_mse(text: &str) -> String {
        text.lines().nth(1).and_then(|line| line.split(',').nth(8)).unwrap().to_owned()
    }

    #[test]
    fn names_with_commas_and_quotes_are_quoted() {
        let row = Measurement { sampler: "a,\"b\"\n".into(), ..synthetic::row("", "1spp", 0) };
        let summary = Summary::of(std::slice::from_ref(&row)).unwrap();
        let bytes = encode(std::slice::from_ref(&row), &summary).unwrap();
        let mut reader = csv::Reader::from_reader(bytes.as_slice());
        assert_eq!(&reader.records().next().unwrap().unwrap()[2], "a,\"b\"\n");
    }
}
