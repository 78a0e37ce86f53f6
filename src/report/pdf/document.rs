//! The file around a page: objects, and the table of where they are.

use std::io::Write;

use anyhow::{Context, Result, ensure};
use flate2::{Compression, write::ZlibEncoder};

/// A file of one page.
#[derive(Default)]
pub struct Document {
    /// Different opacities of the page.
    opacities: Vec<f64>,
    /// Pictures as objects.
    pictures: Vec<Vec<u8>>,
}

impl Document {
    /// The name of a graphics state of this opacity.
    pub fn opacity(&mut self, opacity: f64) -> String {
        let at = self.opacities.iter().position(|known| *known == opacity).unwrap_or_else(|| {
            self.opacities.push(opacity);
            self.opacities.len() - 1
        });
        format!("G{at}")
    }

    /// Adds a picture and returns its name. Its compressed rows are taken as they are: those of PNG are a format of PDF, too.
    ///
    /// # Errors
    /// If it is not a PNG file of 8 bits for each of red, green and blue, in one pass.
    pub fn picture(&mut self, png: &[u8]) -> Result<String> {
        let rest = png.strip_prefix(b"\x89PNG\r\n\x1a\n").context("a picture is no PNG")?;
        let (mut rest, mut header, mut rows) = (rest, None, Vec::new());
        while let Some((length, after)) = rest.split_first_chunk::<4>() {
            let length = u32::from_be_bytes(*length) as usize;
            let (kind, after) = after.split_first_chunk::<4>().context("a chunk of a picture has no name")?;
            let data = after.get(..length).context("a chunk of a picture is cut short")?;
            match kind {
                b"IHDR" => header = Some(data),
                b"IDAT" => rows.extend_from_slice(data),
                _ => {}
            }
            // The checksum is 4 bytes.
            rest = after.get(length + 4..).unwrap_or_default();
        }
        let header = header.filter(|header| header.len() == 13).context("a picture has no header")?;
        ensure!(header[8..] == [8, 2, 0, 0, 0], "a picture is not of 8 bits for each of red, green and blue");
        let side = |at: usize| u32::from_be_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
        let (width, height, length) = (side(0), side(4), rows.len());
        let mut object = format!(
            "<< /Type /XObject /Subtype /Image /Width {width} /Height {height} /ColorSpace /DeviceRGB /BitsPerComponent 8 /Filter /FlateDecode \
             /DecodeParms << /Predictor 15 /Colors 3 /BitsPerComponent 8 /Columns {width} >> /Length {length} >>\nstream\n"
        )
        .into_bytes();
        object.extend(rows);
        object.extend(b"\nendstream");
        self.pictures.push(object);
        Ok(format!("P{}", self.pictures.len() - 1))
    }

    /// The file: the page of a size in points with what is drawn on it.
    ///
    /// # Errors
    /// If it cannot be compressed.
    pub fn finish(self, [width, height]: [f64; 2], content: &str) -> Result<Vec<u8>> {
        const FIRST_PICTURE: usize = 8;
        let states: String = (self.opacities.iter().enumerate())
            .map(|(k, opacity)| format!("/G{k} << /ca {opacity} /CA {opacity} >> "))
            .collect();
        let pictures: String = (0..self.pictures.len()).map(|k| format!("/P{k} {} 0 R ", FIRST_PICTURE + k)).collect();
        let mut packer = ZlibEncoder::new(Vec::new(), Compression::default());
        packer.write_all(content.as_bytes())?;
        let packed = packer.finish()?;
        let mut stream = format!("<< /Filter /FlateDecode /Length {} >>\nstream\n", packed.len()).into_bytes();
        stream.extend(packed);
        stream.extend(b"\nendstream");

        let font =
            |name: &str, encoding: &str| format!("<< /Type /Font /Subtype /Type1 /BaseFont /{name}{encoding} >>");
        let mut objects: Vec<Vec<u8>> = [
            "<< /Type /Catalog /Pages 2 0 R >>".to_owned(),
            "<< /Type /Pages /Kids [3 0 R] /Count 1 >>".to_owned(),
            format!(
                "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.2} {height:.2}] /Contents 4 0 R /Resources << \
                 /Font << /F1 5 0 R /F2 6 0 R /F3 7 0 R >> /ExtGState << {states}>> /XObject << {pictures}>> >> >>"
            ),
        ]
        .map(String::into_bytes)
        .into();
        objects.push(stream);
        objects.push(font("Helvetica", " /Encoding /WinAnsiEncoding").into_bytes());
        objects.push(font("Helvetica-Bold", " /Encoding /WinAnsiEncoding").into_bytes());
        objects.push(font("Symbol", "").into_bytes());
        objects.extend(self.pictures);

        // The second line says that the file is not text.
        let mut file = b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n".to_vec();
        let mut places = Vec::new();
        for (k, object) in objects.iter().enumerate() {
            places.push(file.len());
            file.extend(format!("{} 0 obj\n", k + 1).bytes());
            file.extend(object);
            file.extend(b"\nendobj\n");
        }
        let (table, count) = (file.len(), objects.len() + 1);
        file.extend(format!("xref\n0 {count}\n0000000000 65535 f \n").bytes());
        places.iter().for_each(|place| file.extend(format!("{place:010} 00000 n \n").bytes()));
        file.extend(format!("trailer\n<< /Size {count} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n").bytes());
        Ok(file)
    }
}
