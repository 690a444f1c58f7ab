//! The fundus photograph on the command line, for the renderer.

use std::path::PathBuf;

/// The photograph that is asked for.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct FundusArgs {
    /// Fundus photograph to lay on the retina: a square JPEG or PNG that its round field fills.
    #[arg(long, value_name = "PHOTO")]
    pub fundus: Option<PathBuf>,
    /// The eye that it shows: left or right [default: left].
    #[arg(long, value_name = "SIDE", value_parser = ["left", "right"], requires = "fundus")]
    pub fundus_eye: Option<String>,
    /// Where its fovea lies, as shares of width and height from the upper left [default: its
    /// middle].
    #[arg(long, value_name = "X,Y", value_parser = shares, requires = "fundus")]
    pub fundus_fovea: Option<String>,
    /// Its field as photographers give it, the angle that the camera takes in, degrees [default:
    /// 45].
    #[arg(long, value_name = "DEG", value_parser = degrees, requires = "fundus")]
    pub fundus_field: Option<String>,
}

impl FundusArgs {
    /// The options as the renderer takes them.
    pub fn arguments(&self) -> Vec<String> {
        let photograph = self.fundus.as_ref().map(|f| f.display().to_string());
        let named = [
            ("--fundus", photograph.as_ref()),
            ("--fundus-eye", self.fundus_eye.as_ref()),
            ("--fundus-fovea", self.fundus_fovea.as_ref()),
            ("--fundus-field", self.fundus_field.as_ref()),
        ];
        let given = named.into_iter().filter_map(|(name, value)| Some([name.to_owned(), value?.clone()]));
        given.flatten().collect()
    }
}

fn shares(text: &str) -> Result<String, String> {
    let is_share = |t: &str| t.trim().parse::<f32>().is_ok_and(|s| (0.0..=1.0).contains(&s));
    let good = text.split_once(',').is_some_and(|(x, y)| is_share(x) && is_share(y));
    let expected = "expected two shares from 0 to 1, for instance 0.62,0.5";
    good.then(|| text.to_owned()).ok_or_else(|| expected.into())
}

fn degrees(text: &str) -> Result<String, String> {
    let good = text.parse::<f32>().is_ok_and(|d| (10.0..=60.0).contains(&d));
    good.then(|| text.to_owned()).ok_or_else(|| "expected 10 to 60 degrees".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        fundus: FundusArgs,
    }

    #[test]
    fn what_is_given_reaches_the_renderer_and_nonsense_is_refused() {
        let parse = |words: &[&str]| Line::try_parse_from(std::iter::once(&"x").chain(words));
        let given = ["--fundus", "a.jpg", "--fundus-eye", "right", "--fundus-fovea", "0.6,0.5"];
        assert_eq!(parse(&given).unwrap().fundus.arguments(), given);
        assert!(parse(&[]).unwrap().fundus.arguments().is_empty());
        for wrong in [
            &["--fundus-eye", "right"][..],
            &["--fundus", "a", "--fundus-eye", "both"],
            &["--fundus", "a", "--fundus-fovea", "0.6"],
            &["--fundus", "a", "--fundus-fovea", "6,0.5"],
            &["--fundus", "a", "--fundus-field", "180"],
        ] {
            assert!(parse(wrong).is_err(), "{wrong:?} was taken");
        }
    }
}
