//! `results.csv`: every run and the means, in full precision.

use anyhow::Result;

use super::Row;
use super::summary::Summary;

/// The columns, in this order.
const COLUMNS: [&str; 16] = [
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
];

/// The bytes of the file: for each sampler at each budget its runs, then the row of means, whose `run` is `mean`.
pub fn encode(rows: &[Row], summary: &Summary) -> Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(COLUMNS)?;
    for group in &summary.groups {
        let of_group = |row: &&Row| row.run.is_some() && row.sampler == group.sampler && row.budget == group.budget;
        for row in rows.iter().filter(of_group).chain([&group.mean]) {
            writer.write_record(record(row))?;
        }
    }
    Ok(writer.into_inner()?)
}

/// Floats are the shortest decimals that read back to the same bits.
fn record(row: &Row) -> [String; 16] {
    let run = row.run.map_or("mean".to_owned(), |run| run.to_string());
    [
        row.scene.clone(),
        row.env.clone(),
        row.sampler.clone(),
        row.budget.clone(),
        run,
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
    ]
}

#[cfg(test)]
mod tests {
    use super::super::synthetic;
    use super::*;

    #[test]
    fn runs_and_means_come_back_to_the_last_bit() {
        let comparison = synthetic::comparison();
        let summary = Summary::of(&comparison.rows).unwrap();
        let bytes = encode(&comparison.rows, &summary).unwrap();
        let text = String::from_utf8(bytes.clone()).unwrap();
        assert!(text.starts_with(
            "scene,env,sampler,budget,run,spp,rays_per_sample,seconds,mse,relmse,relmse_trimmed,ttuv,mean_luminance,\
             max_weight,seed,version\n"
        ));
        let mut reader = csv::Reader::from_reader(bytes.as_slice());
        let records: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        assert_eq!(records.len(), comparison.rows.len() + summary.groups.len());
        assert_eq!(records.iter().filter(|record| &record[4] == "mean").count(), summary.groups.len());
        for row in &comparison.rows {
            let found = records.iter().any(|record| {
                record[2] == row.sampler
                    && record[3] == row.budget
                    && Some(record[4].to_owned()) == row.run.map(|run| run.to_string())
                    && record[8].parse::<f64>().unwrap().to_bits() == row.mse.to_bits()
                    && record[14].parse::<u64>().unwrap() == row.seed
            });
            assert!(found, "{row:?}");
        }
    }

    #[test]
    fn names_with_commas_and_quotes_are_quoted() {
        let row = Row { sampler: "a,\"b\"\n".into(), ..synthetic::row("", "1spp", 0) };
        let summary = Summary::of(std::slice::from_ref(&row)).unwrap();
        let bytes = encode(std::slice::from_ref(&row), &summary).unwrap();
        let mut reader = csv::Reader::from_reader(bytes.as_slice());
        assert_eq!(&reader.records().next().unwrap().unwrap()[2], "a,\"b\"\n");
    }
}
