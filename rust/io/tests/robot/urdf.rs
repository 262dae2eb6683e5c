//! What a URDF may hold beside links and joints, and what is doubtful in it but has one meaning.

use super::{NO_JOINTS, TWO_PARTS, sparrow_texts};
use crate::common::assert_within;
use flight_core::dynamics::Dynamics;
use flight_core::kinematics::{Kinematics, RobotState};
use flight_core::robot::RobotModel;
use flight_io::{LoadedRobot, RobotFiles, hold, read_urdf, robot_from_text};
use std::path::PathBuf;
use std::time::{Duration, Instant};

fn load(toml: &str, urdf: &str) -> Result<LoadedRobot, String> {
    let files = RobotFiles { toml: toml.to_owned(), urdf: urdf.to_owned(), origin: "robot.toml".to_owned() };
    files.load().map_err(|error| error.to_string())
}

fn two_parts(from: &str, to: &str) -> Result<LoadedRobot, String> {
    assert!(TWO_PARTS.contains(from), "{from}");
    load(NO_JOINTS, &TWO_PARTS.replacen(from, to, 1))
}

#[track_caller]
fn assert_same(ours: &RobotModel, expected: &RobotModel) {
    for (body, other) in ours.bodies.iter().zip(&expected.bodies) {
        assert_eq!((&body.name, body.mass), (&other.name, other.mass));
        assert_within!((body.com_b - other.com_b).amax(), 1e-15);
        assert_within!((body.inertia_b - other.inertia_b).amax(), 1e-15);
    }
    assert_eq!(ours.bodies.len(), expected.bodies.len());
}

#[test]
fn only_tags_directly_within_the_robot_count() {
    let expected = load(NO_JOINTS, TWO_PARTS).unwrap();
    for extra in [
        "<transmission name='t'><joint name='mount'><hardwareInterface>Effort</hardwareInterface></joint></transmission>",
        "<gazebo><plugin name='feet'><link>load</link><joint>mount</joint></plugin></gazebo>",
        "<gazebo><model name='prop'><link name='base'><inertial/></link></model></gazebo>",
        "<sim:link xmlns:sim='urn:simulator'/>",
    ] {
        let found = two_parts("</robot>", &format!("{extra}</robot>")).unwrap();
        assert_same(&found.model, &expected.model);
        assert!(found.warnings.is_empty());
    }
    for robot in ["<robot xmlns='urn:urdf' name=", "<robot xmlns:xacro='urn:xacro' name="] {
        assert_same(&two_parts("<robot name=", robot).unwrap().model, &expected.model);
    }
}

/// Of a macro neither links nor numbers are known.
#[test]
fn macros_are_refused_with_element_and_line() {
    let within = |namespace: &str, tag: &str| {
        two_parts("name=\"two_parts\">", &format!("name=\"two_parts\" {namespace}>\n{tag}"))
    };
    let ros = "http://www.ros.org/wiki/xacro";
    for (namespace, tag) in [
        (format!("xmlns:xacro='{ros}'"), "<xacro:leg prefix='l'/>"),
        (format!("xmlns:macro='{ros}'"), "<macro:leg/>"),
        ("xmlns:xacro='urn:any'".to_owned(), "<gazebo><xacro:leg/></gazebo>"),
        (String::new(), "<xacro:leg/>"),
    ] {
        let message = within(&namespace, tag).unwrap_err();
        assert!(message.contains("two.urdf") && message.contains("line 2 has <xacro:"), "{message}");
        assert!(message.contains("expand it with xacro first"), "{message}");
    }
    for (from, to, line) in [
        ("<mass value=\"2\"/>", "<mass value=\"${2 * m}\"/>", 4),
        ("<child link=\"load\"/>", "<child link=\"$(arg side)_load\"/>", 10),
    ] {
        let message = two_parts(from, to).unwrap_err();
        assert!(
            message.contains(&format!("line {line} has `$")) && message.contains("xacro first"),
            "{message}"
        );
    }
    assert!(within("", "<gazebo><plugin path='${HOME}/worlds'/></gazebo>").is_ok());
}

#[test]
fn tags_that_are_not_used_are_counted() {
    let path = PathBuf::from("counted/two.urdf");
    let count = |text: &str| {
        hold(&path, text.as_bytes().to_vec());
        let unused = read_urdf(&path).unwrap().0.unused;
        unused.into_iter().map(|(tag, count)| format!("{count} {tag}")).collect::<Vec<_>>().join(", ")
    };
    assert_eq!(count(TWO_PARTS), "");
    let shape = "<geometry><box size='1 1 1'/></geometry>";
    let of_link = format!("<visual>{shape}<material/></visual><visual/><collision>{shape}</collision>");
    let text = TWO_PARTS
        .replace("<link name=\"load\">", &format!("<link name=\"load\"><collision>{shape}</collision>"))
        .replace("<link name=\"base\">", &format!("<link name=\"base\">{of_link}"))
        .replace("<child link=\"load\"/>", "<child link=\"load\"/><axis xyz='0 0 1'/>")
        .replace("</robot>", "<gazebo><link/></gazebo><gazebo/><o:link xmlns:o='urn:o'/></robot>");
    assert_eq!(count(&text), "1 axis, 1 collision, 2 gazebo, 1 link, 1 material");
}

/// A robot moves otherwise than its URDF says: the joints are named, with what has these numbers in a flight.
#[test]
fn friction_damping_and_soft_limits_are_not_used_without_a_word() {
    let (toml, urdf) = sparrow_texts();
    let with = |joint: &str, tag: &str| {
        let opening = format!("<joint name=\"{joint}\"");
        assert!(urdf.contains(&opening));
        let (before, after) = urdf.split_once(&opening).unwrap();
        load(&toml, &format!("{before}{opening}{}", after.replacen('>', &format!(">{tag}"), 1)))
            .unwrap()
            .warnings
    };
    let found = with("waist", "<dynamics friction='2' damping='5'/>");
    let [only] = found.as_slice() else { panic!("one warning expected: {found:?}") };
    for words in ["`waist`", "friction up to 2", "damping up to 5", "simulator.motors"] {
        assert!(only.contains(words), "{only}");
    }
    let found =
        with("neck", "<safety_controller soft_lower_limit='-0.1' soft_upper_limit='0.1' k_velocity='1'/>");
    assert!(matches!(found.as_slice(), [only] if only.contains("`neck`") && only.contains("limits_deg")));
    for nothing in ["<dynamics/>", "<dynamics friction='0' damping='0'/>"] {
        assert!(with("waist", nothing).is_empty());
    }
    assert!(with("l_ankle", "<dynamics friction='2'/>").is_empty(), "a fixed joint");
}

#[test]
fn limits_beyond_a_turn_are_degrees() {
    let (toml, urdf) = sparrow_texts();
    for (range, warns) in
        [("-90\" upper=\"90", true), ("-1.2\" upper=\"7", true), ("-6.2832\" upper=\"6.2832", false)]
    {
        let turned = urdf.replacen("-1.2\" upper=\"1.5", range, 1);
        assert_ne!(turned, urdf);
        let warnings = load(&toml, &turned).unwrap().warnings;
        let named = |warning: &String| warning.contains("`l_shoulder`") && warning.contains("rad");
        assert!(warnings.len() == usize::from(warns) && warnings.iter().all(named), "{range}: {warnings:?}");
    }
    let metres = HAND.replacen("upper=\"1\"", "upper=\"90\"", 1);
    assert!(load(&format!("{NO_JOINTS}\nlocked = {{ lead = 0.4 }}"), &metres).unwrap().warnings.is_empty());
}

/// A joint that only lets the robot float is not needed, and the message says what is left without it.
#[test]
fn a_floating_root_says_what_to_do() {
    for kind in ["floating", "planar"] {
        let message = two_parts("type=\"fixed\"", &format!("type=\"{kind}\"")).unwrap_err();
        let way = format!(
            "is {kind}; expected revolute, continuous, prismatic or fixed; without this joint and link `base`"
        );
        assert!(message.contains(&way) && message.contains("`load` is the base, which floats"), "{message}");
    }
    let below = "<link name='end'/><joint name='b' type='floating'><parent link='load'/><child link='end'/></joint></robot>";
    let message = two_parts("</robot>", below).unwrap_err();
    assert!(message.contains("joint `b` is floating") && !message.contains("without"), "{message}");
}

/// By the file's own mark or declaration; what cannot be decoded is refused with the file and a way on.
#[test]
fn a_urdf_may_be_of_several_encodings() {
    let text = TWO_PARTS.replace("\"load\"", "\"Füße\"");
    let declared = |encoding| format!("<?xml version=\"1.0\" encoding=\"{encoding}\"?>\n{text}");
    let latin = |text: String| text.chars().map(|letter| u8::try_from(u32::from(letter)).unwrap()).collect();
    let utf16 = |mark: u16, bytes: fn(u16) -> [u8; 2]| -> Vec<u8> {
        [mark].into_iter().chain(text.encode_utf16()).flat_map(bytes).collect()
    };
    let load = |name: &str, bytes: Vec<u8>| {
        let folder = PathBuf::from("encodings").join(name);
        hold(&folder.join("robot.toml"), NO_JOINTS.into());
        hold(&folder.join("two.urdf"), bytes);
        RobotFiles::read(&folder.join("robot.toml")).and_then(|files| files.load())
    };
    for (name, bytes) in [
        ("utf-8", declared("UTF-8").into_bytes()),
        ("mark", format!("\u{feff}{text}").into_bytes()),
        ("little", utf16(0xFEFF, u16::to_le_bytes)),
        ("big", utf16(0xFEFF, u16::to_be_bytes)),
        ("latin", latin(declared("ISO-8859-1"))),
    ] {
        assert!(load(name, bytes).unwrap().links.contains_key("Füße"), "{name}");
    }
    for (name, bytes) in [
        ("undeclared", latin(text.clone())),
        ("unknown", latin(declared("windows-1252"))),
        ("unmarked", text.encode_utf16().flat_map(u16::to_le_bytes).collect()),
    ] {
        let message = load(name, bytes).unwrap_err().to_string();
        assert!(message.contains("two.urdf") && message.contains("iconv"), "{name}: {message}");
    }
    // The declaration makes no difference.
    let plain = declared("windows-1252").replace("Füße", "load").into_bytes();
    assert!(load("plain", plain).is_ok());
}

/// What another reader of URDFs reads and this one does not is refused where it moves a part, and named.
#[test]
fn what_would_make_another_robot_is_read_or_refused_by_name() {
    for (from, to, words) in [
        // Attributes: of joint, inertial and visual, and of numbers in other units or places.
        (
            "xyz=\"0 0 1\" rpy=\"0 0 1.5707963267948966\"",
            "xyz=\"0 0 1\" quat_xyzw=\"0 0 1 0\"",
            "`quat_xyzw` of the <origin> of joint `mount` is `0 0 1 0`",
        ),
        (
            "xyz=\"0.5 0 0\"",
            "xyz=\"0.5 0 0\" quat_xyzw=\"1 0 0 0\"",
            "`quat_xyzw` of the <origin> of link `load`",
        ),
        (
            "<inertial>",
            "<visual><origin quat_wxyz=\"0 1 0 0\"/><geometry/></visual><inertial>",
            "`quat_wxyz` of the <origin> of link `base`",
        ),
        (
            "<inertial>",
            "<collision><geometry><cylinder axis=\"x\" radius=\"1\" length=\"1\"/></geometry></collision><inertial>",
            "`axis` of the <cylinder> of link `base`",
        ),
        (
            "<mass value=\"2\"/>",
            "<mass value=\"2\" units=\"g\"/>",
            "`units` of the <mass> of link `base` is `g`",
        ),
        ("ixy=\"0\"", "ixy=\"0\" frame=\"world\"", "`frame` of the <inertia> of link `base`"),
        ("<link name=\"load\"", "<link mass=\"3\" name=\"load\"", "`mass` of link `load` is `3`"),
        (
            "<child link=\"load\"/>",
            "<child link=\"load\" pose=\"1 0 0\"/>",
            "`pose` of the <child> of joint `mount`",
        ),
        // Tags out of their place.
        (
            "<link name=\"load\">",
            "<link name=\"load\"><origin xyz=\"0 0 1\"/>",
            "<origin> of link `load` is not read in <link>",
        ),
        ("<link name=\"load\">", "<link name=\"load\"><pose>0 0 1 0 0 0</pose>", "<pose> of link `load`"),
        (
            "<link name=\"load\">",
            "<inertial><mass value=\"1\"/></inertial><link name=\"load\">",
            "<inertial> of robot `two_parts` is not read in <robot>",
        ),
        (
            "</robot>",
            "<loop_joint name=\"bar\"><link1 link=\"base\"/></loop_joint></robot>",
            "loop_joint `bar` is not read in <robot>",
        ),
    ] {
        let message = two_parts(from, to).unwrap_err();
        assert!(
            message.contains("two.urdf") && message.contains(words) && message.contains("expected"),
            "{message}"
        );
    }
    let moving = |joint: &str| {
        HAND.replacen("<limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/>", joint, 1)
    };
    let toml = format!("{NO_JOINTS}\nlocked = {{ lead = 0.4 }}");
    for (joint, words) in [
        ("<axis xzy=\"0 1 0\"/>", "`xzy` of the <axis> of joint `lead`"),
        ("<axis xyz=\"0 1 0\" frame=\"base\"/>", "`frame` of the <axis> of joint `lead`"),
        ("<limit lower_deg=\"-1\"/>", "`lower_deg` of the <limit> of joint `lead`"),
        ("<mimic joint=\"half\" power=\"2\"/>", "`power` of the <mimic> of joint `lead`"),
    ] {
        let message = load(&toml, &moving(joint)).unwrap_err();
        assert!(message.contains(words), "{message}");
    }
    // Harmless: what is of others, says nothing, or concerns drives, pictures and programs.
    let expected = load(NO_JOINTS, TWO_PARTS).unwrap().model;
    for (from, to) in [
        ("<joint name", "<joint dont_collapse=\"true\" xmlns:o=\"urn:o\" o:speed=\"1\" name"),
        (
            "<link name=\"load\">",
            "<link name=\"load\" type=\"laser\"><origin xyz=\"0 0 0\"/><gravity>0</gravity>",
        ),
        ("ixy=\"0\"", "ixy=\"0\" iyx=\"0\""),
        (
            "<inertial>",
            "<visual group=\"a\"><geometry name=\"b\"><box size=\"1 1 1\" scale=\"1 1 1\"/></geometry></visual><inertial>",
        ),
    ] {
        assert_same(&two_parts(from, to).unwrap().model, &expected);
    }
    for joint in [
        "<axis xyz=\"1 0 0\" rpy=\"0 0 0\"/>",
        "<limit lower=\"-1\" upper=\"1\" acceleration=\"4\" jerk=\"9\"/>",
    ] {
        load(&toml, &moving(joint)).unwrap();
    }
}

/// Where tools know no limit they write 0, −1 or infinity; a number of the TOML file comes before any of the URDF.
#[test]
fn limits_that_mean_none_are_none() {
    let (toml, urdf) = sparrow_texts();
    let limit = "lower=\"-1.2\" upper=\"1.5\" effort=\"40\" velocity=\"4\"";
    assert!(urdf.contains(limit));
    let with = |limits: &str, keys: &str| {
        let toml = toml.replacen("{ name = \"l_shoulder\"", &format!("{{ name = \"l_shoulder\"{keys}"), 1);
        load(&toml, &urdf.replacen(limit, limits, 1))
    };
    let range = "lower=\"-1.2\" upper=\"1.5\"";
    let keys = ", torque_max = 7.0, velocity_max_deg = 90.0";
    for none in ["0", "-1", "-1.0", "inf", "+Infinity", "1e308", "1.7976931348623157e+308", "2e999"] {
        let limits = format!("{range} effort=\"{none}\" velocity=\"{none}\"");
        let found = with(&limits, keys).unwrap().model;
        assert_eq!(
            (found.joints[3].torque_max, found.joints[3].velocity_max),
            (7.0, 90_f64.to_radians()),
            "{none}"
        );
        let message = with(&limits, "").err().unwrap();
        assert!(message.contains("torque_max of joint `l_shoulder` is missing"), "{none}: {message}");
    }
    for wrong in ["-2", "-40"] {
        let limits = format!("{range} effort=\"{wrong}\" velocity=\"{wrong}\"");
        assert!(with(&limits, keys).is_ok(), "overridden");
        assert!(
            with(&limits, "")
                .err()
                .unwrap()
                .contains(&format!("effort limit of joint `l_shoulder` is {wrong}"))
        );
    }
    let rest = "effort=\"40\" velocity=\"4\"";
    for (ends, warns) in [
        ("lower=\"-inf\" upper=\"inf\"", false),
        ("lower=\"-1e308\" upper=\"1e308\"", false),
        ("lower=\"0\" upper=\"inf\"", true),
        ("lower=\"inf\" upper=\"-inf\"", true),
        ("lower=\"-1\" upper=\"-1\"", true),
    ] {
        let found = with(&format!("{ends} {rest}"), ", limits_deg = [-70.0, 80.0]").unwrap();
        assert!(found.model.joints[3].stops.1.is_infinite(), "{ends}");
        assert_eq!(found.warnings.len(), usize::from(warns), "{ends}: {:?}", found.warnings);
        let message = with(&format!("{ends} {rest}"), "").err().unwrap();
        assert!(message.contains("limits_deg of joint `l_shoulder` is missing"), "{ends}: {message}");
    }
    assert!(with(&format!("{range} effort=\"nan\" velocity=\"4\""), "").err().unwrap().contains("is `nan`"));
}

#[test]
fn axes_are_directions_and_those_of_fixed_joints_mean_nothing() {
    let (toml, urdf) = sparrow_texts();
    let longer = urdf.replacen("<axis xyz=\"0 0.8 0.6\"/>", "<axis xyz=\"0 8 6\"/>", 1);
    let found = load(&toml, &longer).unwrap();
    assert_within!((found.model.joints[3].axis_b.y - 0.8).abs(), 1e-15);
    assert!(matches!(found.warnings.as_slice(), [only] if only.contains("axis of joint `l_shoulder`")));
    assert!(load(&toml, &urdf).unwrap().warnings.is_empty());
    let fixed = "<child link=\"load\"/><axis xyz=\"0 0 0\"/><limit lower=\"none\"/><mimic joint=\"none\"/>";
    assert!(two_parts("<child link=\"load\"/>", fixed).unwrap().warnings.is_empty());
}

/// Half a kilogram on three of its moments fails the inequality; the base it is fixed to does not.
#[test]
fn an_impossible_inertia_of_a_link_counts_if_that_of_the_body_is_possible() {
    let found = two_parts("izz=\"0.5\"", "izz=\"0.8\"").unwrap();
    assert!(
        matches!(found.warnings.as_slice(), [only] if only.contains("two.urdf") && only.contains("link `load`"))
    );
    let usual = load(NO_JOINTS, TWO_PARTS).unwrap().model.bodies[0].inertia_b;
    assert_within!((found.model.bodies[0].inertia_b.m33 - usual.m33 - 0.3).abs(), 1e-15);
    let message = two_parts("izz=\"0.5\"", "izz=\"8\"").unwrap_err();
    assert!(message.contains("two.urdf") && message.contains("inertia of body `base`"), "{message}");
}

#[test]
fn a_link_without_mass_has_no_inertia() {
    let found = two_parts("<mass value=\"1\"/>", "<mass value=\"0\"/>").unwrap();
    assert!(matches!(found.warnings.as_slice(), [only] if only.contains("link `load`")));
    let without = load(
        NO_JOINTS,
        &TWO_PARTS
            .replace("<mass value=\"1\"/>", "<mass value=\"1e-12\"/>")
            .replace("0.3", "0")
            .replace("0.4", "0")
            .replace("0.5\"/>", "0\"/>"),
    );
    assert_within!((found.model.bodies[0].inertia_b - without.unwrap().model.bodies[0].inertia_b).amax(), 1e-11, because "of 1e-12 kg");
    let message = two_parts("<mass value=\"1\"/>", "<mass value=\"-0.5\"/>").unwrap_err();
    assert!(message.contains("two.urdf") && message.contains("mass of link `load` is -0.5"), "{message}");
}

const HAND: &str = r#"<robot name="hand">
  <link name="base"><inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="a"/><link name="b"/>
  <link name="c"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="lead" type="prismatic"><parent link="base"/><child link="a"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="half" type="prismatic"><parent link="a"/><child link="b"/><limit lower="-1" upper="1"/>
    <mimic joint="lead" multiplier="0.5" offset="0.1"/></joint>
  <joint name="last" type="prismatic"><parent link="b"/><child link="c"/><limit lower="-1" upper="1"/>
    <mimic joint="half" multiplier="-2"/></joint>
</robot>"#;

/// 0.4 + (0.5 · 0.4 + 0.1) − 2 · 0.3; a position in `locked` comes first.
#[test]
fn mimic_joints_follow_a_held_joint() {
    let held = |locked: &str| load(&format!("{NO_JOINTS}\nlocked = {{ {locked} }}"), HAND);
    for (locked, positions) in [
        ("lead = 0.4", [0.4, 0.3, -0.6]),
        ("lead = 0.4, half = 0.2", [0.4, 0.2, -0.4]),
        ("lead = 0.4, half = 0.2, last = 0.7", [0.4, 0.2, 0.7]),
    ] {
        let found = held(locked).unwrap();
        let names = ["lead", "half", "last"];
        for (name, position) in names.into_iter().zip(positions) {
            assert_within!((found.held[name] - position).abs(), 1e-15, because "a few roundings", "{name}");
        }
        assert_within!((found.links["c"].1.position.x - positions.iter().sum::<f64>()).abs(), 1e-15, because "a few roundings");
    }
    assert!(held("half = 0.2").unwrap_err().contains("joint `lead` is neither"));
    let moving = format!("{NO_JOINTS}\n").replace("[]", "[{ name = 'g', joints = [{ name = 'lead' }] }]");
    let message = load(&moving, HAND).unwrap_err();
    assert!(
        message.contains("joint `half` is a mimic of `lead`") && message.contains("`locked`"),
        "{message}"
    );
    let circle = HAND.replace("mimic joint=\"lead\"", "mimic joint=\"last\"");
    let toml = format!("{NO_JOINTS}\nlocked = {{ lead = 0.4 }}");
    assert!(load(&toml, &circle).unwrap_err().contains("joint `half` is a mimic of itself"));
    let nobody = HAND.replace("mimic joint=\"lead\"", "mimic joint=\"nobody\"");
    assert!(load(&toml, &nobody).unwrap_err().contains("mimic of joint `half` names `nobody`"));
}

/// The parser compares the attributes of a tag with each other.
#[test]
fn a_tag_with_very_many_attributes_is_refused_at_once() {
    let attributes = (0..80_000).fold(String::new(), |text, index| text + &format!(" a{index}=\"\""));
    let start = Instant::now();
    let message = two_parts("<link name=\"load\"", &format!("<link name=\"load\"{attributes}")).unwrap_err();
    assert!(message.contains("two.urdf") && message.contains("attributes"), "{message}");
    assert!(start.elapsed() < Duration::from_secs(1));
}

#[test]
fn a_urdf_alone_lists_links_joints_and_shapes() {
    let (_, text) = sparrow_texts();
    let path = PathBuf::from("alone/sparrow.urdf");
    hold(&path, text.clone().into_bytes());
    let (urdf, shapes) = read_urdf(&path).unwrap();
    assert_eq!(urdf.name.as_deref(), Some("sparrow"));
    assert_eq!(urdf.links.len(), urdf.joints.len() + 1);
    assert_eq!(shapes.len(), text.matches("<visual>").count());

    // Without a visual shape, those for collisions are a link's.
    let shape = |tag: &str, solid: &str| {
        let parts = format!("<{tag}><origin xyz='1 2 3'/><geometry>{solid}</geometry></{tag}>");
        hold(
            &path,
            TWO_PARTS.replace("<link name=\"load\">", &format!("<link name=\"load\">{parts}")).into_bytes(),
        );
        read_urdf(&path).map(|(_, shapes)| shapes)
    };
    for (solid, kind, size) in [
        ("<sphere radius='0.1'/>", "sphere", [0.1; 3]),
        ("<cylinder radius='0.1' length='0.5'/>", "cylinder", [0.1, 0.1, 0.5]),
        ("<capsule radius='0.1' length='0.5'/>", "capsule", [0.1, 0.1, 0.5]),
        ("<box size='0.1 0.2 0.3'/>", "box", [0.1, 0.2, 0.3]),
        ("<mesh filename='a.stl'/>", "mesh", [1.0; 3]),
    ] {
        for tag in ["visual", "collision"] {
            let [found] = &shape(tag, solid).unwrap()[..] else { panic!("{tag}: one shape expected") };
            assert_eq!((found.link.as_str(), found.kind, found.size), ("load", kind, size));
            assert_eq!(found.origin.position.as_slice(), [1.0, 2.0, 3.0]);
        }
    }
    for (solid, words) in [
        ("", "<geometry> of link `load` is empty"),
        ("<sphere radius='1'/><box size='1 1 1'/>", "has <sphere> and <box>; expected one solid"),
        ("<cone/>", "<geometry> of link `load` is a <cone>"),
        ("<cylinder length='1'/>", "<cylinder> of link `load` has no `radius`"),
        ("<sphere radius='wide'/>", "`radius` of the <sphere> of link `load` is `wide`"),
        ("<mesh/>", "<mesh> of link `load` has no `filename`"),
    ] {
        let message = shape("visual", solid).unwrap_err().to_string();
        assert!(message.contains("alone/sparrow.urdf") && message.contains(words), "{message}");
    }
}

/// A joint that the URDF gives an empty range, or none, may have one in the TOML file, or be locked.
#[test]
fn a_joint_without_a_range_needs_one_only_to_move() {
    let (toml, urdf) = sparrow_texts();
    let without = urdf.replacen(" lower=\"-1.2\" upper=\"1.5\"", "", 1);
    assert_ne!(without, urdf);
    assert!(
        robot_from_text(&toml, &without, "robot.toml")
            .unwrap_err()
            .to_string()
            .contains("`l_shoulder` is missing")
    );
    let given =
        toml.replacen("{ name = \"l_shoulder\"", "{ name = \"l_shoulder\", limits_deg = [-70.0, 80.0]", 1);
    let found = robot_from_text(&given, &without, "robot.toml").unwrap();
    assert!(found.joints[3].stops.1.is_infinite());
    let empty = urdf.replacen("lower=\"-1.2\" upper=\"1.5\"", "lower=\"1.5\" upper=\"-1.2\"", 1);
    let found = load(&given, &empty).unwrap();
    assert!(found.model.joints[3].stops.1.is_infinite());
    assert!(matches!(found.warnings.as_slice(), [only] if only.contains("`l_shoulder` are 1.5 to -1.2")));
}

/// A shoulder of two joints, with nothing but a frame between them, and an arm of 2.5 kg behind.
fn shoulder(second: &str, at: &str) -> String {
    let inertial = "<inertial><mass value='2.5'/><inertia ixx='0.03' iyy='0.03' izz='0.03' ixy='0' ixz='0' iyz='0'/></inertial>";
    let limit = "<limit lower='-1' upper='1' effort='9' velocity='9'/>";
    format!(
        "<robot name='shoulder'><link name='base'>{inertial}</link><link name='yoke'/><link name='arm'>{inertial}</link>
        <joint name='pitch' type='revolute'><parent link='base'/><child link='yoke'/><axis xyz='0 1 0'/>{limit}</joint>
        <joint name='roll' {second}><parent link='yoke'/><child link='arm'/><origin xyz='{at}'/>{limit}</joint></robot>"
    )
}

/// Both joints move the arm, each otherwise, in every posture: the mass matrix is positive definite.
#[test]
fn a_link_without_mass_between_two_joints_moves_with_what_hangs_from_it() {
    let groups = "joint_groups = [{ name = 'arm', joints = [{ name = 'pitch' }, { name = 'roll' }] }]";
    let toml = NO_JOINTS.replace("joint_groups = []", groups);
    let across = "type='revolute'><axis xyz='1 0 0'/";
    for (second, at) in [
        (across, "0 0 0"),
        ("type='revolute'><axis xyz='0 1 0'/", "0 0 -0.1"),
        ("type='prismatic'><axis xyz='0 1 0'/", "0 0 0"),
    ] {
        let robot = load(&toml, &shoulder(second, at)).unwrap().model;
        assert_eq!((robot.bodies[1].mass, robot.bodies[2].mass), (0.0, 2.5));
        for angle in [-1.0, 0.0, 0.5] {
            let mut state = RobotState::zero(2);
            state.joint_position.fill(angle);
            let (mut kinematics, mut dynamics) = (Kinematics::new(&robot), Dynamics::new(&robot));
            kinematics.update(&robot, &state);
            dynamics.update(&robot, &state, &kinematics);
            let least = dynamics.mass_matrix.symmetric_eigenvalues().min();
            assert!(least > 1e-3, "{second} at {angle} rad: {least}");
        }
    }
    // The same axis twice, and nothing behind the yoke, leave a motion without inertia.
    for urdf in [
        shoulder("type='revolute'><axis xyz='0 1 0'/", "0 0.2 0"),
        shoulder(across, "0 0 0").replacen(
            "<link name='arm'><inertial><mass value='2.5'/>",
            "<link name='arm'><inertial><mass value='0'/>",
            1,
        ),
    ] {
        let message = load(&toml, &urdf).unwrap_err();
        assert!(message.contains("mass of body `") && message.contains("another axis"), "{message}");
    }
}

#[test]
fn a_robot_of_too_many_joints_is_refused_in_words() {
    let names = (0..1500).map(|k| format!("{{ name = 'j{k}' }}")).collect::<Vec<_>>().join(", ");
    let groups = format!("joint_groups = [{{ name = 'chain', joints = [{names}] }}]");
    let toml = NO_JOINTS.replace("joint_groups = []", &groups);
    let message = load(&toml, TWO_PARTS).unwrap_err();
    assert!(message.contains("number of joints is 1500; expected at most 512"), "{message}");
}
