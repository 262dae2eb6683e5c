//! Missions and recorded references: what cannot be flown is refused.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use flight_core::control::law::mission::Commands;
use flight_io::MissionConfig;
use flight_io::csv::{Csv, Kind};
use flight_io::mission::{COLUMNS, load_mission, parse_recording};

#[test]
fn what_cannot_be_flown_is_refused_by_line() {
    let header = COLUMNS[..7].join(",");
    let cases = [
        (String::new(), "the first 7, 10, 13 or 16 names"),
        ("time,x,y,z\n".to_owned(), "line 1 of reference file r.csv is time,x,y,z"),
        (
            "time,y,x,z,roll,pitch,yaw\n0,0,0,1,0,0,0\n".to_owned(),
            "line 1 of reference file r.csv is time,y,x,z,roll",
        ),
        (format!("{header},vx\n"), "the first 7, 10, 13 or 16 names"),
        (format!("# source\n{header}\n0,0,0,1,0,0,0\n1,0,0,1,0,0\n"), "line 4"),
        (format!("{header}\n0,0,0,1,0,0,0\n1,0,0,1,0,0,0,0\n"), "expected 7, as its header"),
        (format!("{header}\n0,0,0,1,0,0,0\n1,0,0,one,0,0,0\n"), "column z in line 3"),
        (format!("{header}\n0,0,0,1,5,0,0,0,0\n"), "with decimal commas, `;` between them"),
        (format!("{}\n0;0;0;1.0,5;0;0;0\n", header.replace(',', ";")), "column z in line 2"),
        (
            format!("{header}\n0,0,0,1,0,0,0\n1,0,0,NaN,0,0,0\n"),
            "column z in line 3 of reference file r.csv is NaN",
        ),
        (
            format!("{header}\n0,0,0,1,0,0,0\n1,0,0,\"1,0,0,0\n"),
            "line 3 of reference file r.csv is not closed",
        ),
    ];
    for (text, expected) in cases {
        let message = parse_recording(&text, "r.csv").unwrap_err().to_string();
        assert!(message.contains(expected), "{message} does not say {expected}");
    }
    let nowhere = MissionConfig { file: Some("nowhere.csv".into()), ..MissionConfig::default() };
    assert!(load_mission(&nowhere).unwrap_err().to_string().contains("nowhere.csv"));
}

/// With a semicolon or a tab between the columns, commas are decimal; a spreadsheet begins with a byte order mark, may
/// quote cells and end lines with a carriage return.
#[test]
fn a_table_of_a_spreadsheet_is_read() {
    let header = COLUMNS[..7].join(",");
    let expected = format!("{header}\n0,0,0,1.25,0,0,0\n1.5,0,-2,1,0,0,0\n");
    let quoted = format!("\"{}\"\r", COLUMNS[..7].join("\",\""));
    let text = "\"0\",0,0,\"1.25\",0,0,0\r\n\r\n  # a \"comment\r\n 1.5 , 0,-2, \" 1\" ,0,0,0";
    let read_quoted = parse_recording(&format!("{quoted}{text}"), "r.csv").unwrap();
    assert_eq!(format!("{read_quoted:?}"), format!("{:?}", parse_recording(&expected, "r.csv").unwrap()));
    let read = |text: &str| format!("{:?}", parse_recording(text, "r.csv").unwrap());
    for separator in [";", "\t", "  "] {
        let rows = ["0;0;0;1,25;0;0;0", "1,5;0;-2;1;0;0;0"].join("\n");
        let text = format!("\u{feff}{}\n{}", header.replace(',', ";"), rows).replace(';', separator);
        assert_eq!(read(&text), read(&expected));
        // NumPy writes the header as a comment, below others.
        let commented = text.trim_start_matches('\u{feff}');
        assert_eq!(read(&format!("# of a \"rig\n# {commented}")), read(&expected));
    }
}

/// What loggers write where nothing was measured is no number; other words are, only if they are declared.
#[test]
fn missing_numbers_of_other_programs() {
    let read = |kind, missing: &[(&str, &str)], cells: &str| {
        let text = format!("t,x,y\n0,{cells}\n");
        let mut csv = Csv::new(&text, "log", "a header", |names| names.contains(&"t")).unwrap();
        csv.missing = missing.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect();
        csv.read(&[("x", kind), ("y", kind)]).map(|rows| rows.numbers)
    };
    for cells in ["-nan(ind),1.#QNAN", "#N/A,nan", "-NaN,+nan", "<NA>,NaT", "-1.#IND,nan(snan)", ",\"\""] {
        assert!(read(Kind::Signal, &[], cells).unwrap().iter().all(|number| number.is_nan()), "{cells}");
        assert!(read(Kind::Number, &[], cells).is_err(), "{cells}");
    }
    let message = read(Kind::Signal, &[], "\"[1.0, 2.0]\",0").unwrap_err().to_string();
    assert!(
        message.contains("is [1.0, 2.0]; expected a number, or nothing, each in a column of its own"),
        "{message}"
    );
    for cells in ["--,1", "OFF,2", "nano,3", "1.#,4"] {
        let word = cells.split(',').next().unwrap();
        assert!(read(Kind::Signal, &[("y", word)], cells).unwrap_err().to_string().contains(word), "{cells}");
        assert!(read(Kind::Signal, &[("x", word)], cells).unwrap()[0].is_nan(), "{cells}");
    }
}

#[test]
fn commands_beside_a_file_are_refused() {
    let mission = MissionConfig {
        commands: Commands { up: vec![(1.0, 2.0)], ..Commands::default() },
        file: Some("r.csv".into()),
    };
    let message = load_mission(&mission).unwrap_err().to_string();
    assert!(message.contains("mission.up") && message.contains("r.csv"), "{message}");
}
