//! Files that say something impossible are refused, by name and value.

use super::{NO_JOINTS, TWO_PARTS, robot_file, sparrow_texts};
use flight_core::error::BuildError;
use flight_core::robot::RobotModel;
use flight_io::{load_robot, robot_from_text};

/// A way to spoil a file: replace the first occurrence of a text, then expect these words in the error.
struct Spoil {
    from: &'static str,
    to: &'static str,
    words: &'static [&'static str],
}

const fn spoil(from: &'static str, to: &'static str, words: &'static [&'static str]) -> Spoil {
    Spoil { from, to, words }
}

#[track_caller]
fn assert_says(result: Result<RobotModel, BuildError>, spoil: &Spoil) {
    let message = match result {
        Ok(_) => panic!("accepted `{}`", spoil.to),
        Err(error) => error.to_string(),
    };
    for word in spoil.words {
        assert!(message.contains(word), "`{}`: `{word}` is not in: {message}", spoil.to);
    }
}

#[test]
fn impossible_toml_is_refused_by_name_and_value() {
    let (toml, urdf) = sparrow_texts();
    let cases = [
        // Keys and names.
        spoil("urdf =", "urfd =", &["sparrow.toml", "urfd"]),
        spoil("thrust_max = 100.0", "thrust_max = 100.0\ncolour = 1", &["colour"]),
        spoil("head  = { cda", "head  = { cdb = 1.0, cda", &["cdb"]),
        spoil("k_tt = 0.0\n", "", &["k_tt"]),
        spoil("0.0077, 0.0, 0.0, 0.0, 0.0]", "0.0077, 0.0, 0.0, 0.0]", &["head.cda`", "a list of 5"]),
        spoil("\"pelvis\"", "\"hips\"", &["base_link", "`hips`", "pelvis"]),
        spoil("\"pelvis\"", "\"torso\"", &["root", "pelvis", "`torso`"]),
        spoil("\"l_hip\", limits_deg", "\"l_hop\", limits_deg", &["joint order", "`l_hop`", "l_hip"]),
        spoil("\"r_hip\", limits_deg", "\"l_hip\", limits_deg", &["joint `l_hip`", "more than once"]),
        spoil("\"upper_body\"", "\"legs\"", &["joint group `legs`", "more than once"]),
        spoil("frame = \"back_nozzle\"", "frame = \"tail\"", &["frame of jet `back_jet`", "`tail`"]),
        spoil("frame = \"torso\"", "frame = \"tail\"", &["frame of aerodynamic link `torso`", "`tail`"]),
        spoil("frame = \"l_sole\"", "frame = \"tail\"", &["frame of foot `left`", "`tail`"]),
        spoil("name = \"l_jet\"", "name = \"r_jet\"", &["jet `r_jet`", "more than once"]),
        spoil("name = \"torso\"", "name = \"head\"", &["aerodynamic link `head`", "more than once"]),
        spoil("name = \"right\"", "name = \"left\"", &["foot `left`", "more than once"]),
        spoil("engine = \"E60\"", "engine = \"E61\"", &["engine of jet `l_jet`", "`E61`", "E60"]),
        spoil("family = \"torso\"", "family = \"trunk\"", &["estimated", "`torso`"]),
        spoil("arm   = {", "arms  = {", &["estimated", "`arms`"]),
        spoil(
            "torso = { cda = [0.0161, 0.0, 0.0319, 0.0, 0.0], cna = 0.016 }",
            "",
            &["`torso`", "estimated"],
        ),
        // Locked joints.
        spoil("{ neck = 0.2 }", "{ nack = 0.2 }", &["locked", "`nack`", "neck"]),
        spoil("{ neck = 0.2 }", "{ neck = 0.2, l_hip = 0.0 }", &["joint `l_hip`", "more than once"]),
        spoil("{ neck = 0.2 }", "{ neck = 0.2, l_ankle = 0.0 }", &["joint `l_ankle`", "fixed"]),
        spoil("locked = { neck = 0.2 }", "", &["joint `neck`", "neither in the joint order nor locked"]),
        spoil("{ neck = 0.2 }", "{ neck = -0.6 }", &["locked joint `neck` is -0.6; ", "from -0.5 to 0.5"]),
        // Values.
        spoil("base_link =", "gravity = -9.81\nbase_link =", &["gravity", "-9.81"]),
        spoil("[-40.0, 40.0]", "[40.0, -40.0]", &["limits_deg of joint `l_hip`", "[40.0, -40.0]"]),
        spoil("[-40.0, 40.0]", "[-inf, 40.0]", &["limits_deg[0]`", "-inf"]),
        spoil(
            "\"waist\", limits_deg = [-60.0, 60.0]",
            "\"waist\"",
            &["joint `waist`", "missing", "continuous"],
        ),
        spoil(
            "thrust_max = 100.0",
            "thrust_min = 100.0\nthrust_max = 100.0",
            &["thrust_min of jet", "is 100", "from 0 to less than 100"],
        ),
        spoil("axis = [-1.0, 0.0, 0.0]", "axis = [-1.0, 0.1, 0.0]", &["axis of jet `l_jet`", "0.1"]),
        spoil(
            "axis = [0.0, 0.0, 1.0]",
            "axis = [0.0, 0.0, 0.0]",
            &["axis of aerodynamic link `head`", "0.0, 0.0, 0.0"],
        ),
        spoil("[0.0161, 0.0", "[0.0161, inf", &["`coefficients.estimated.torso.cda[1]`", "inf"]),
        spoil(
            "throttle_min = 0.0",
            "throttle_min = 100.0",
            &["throttle_max of engine `E100` is 100", "above throttle_min = 100 %"],
        ),
        spoil(
            "[[0.08, 0.0, 0.0], [-0.08, 0.04, 0.0], [-0.08, -0.04, 0.0]]",
            "[]",
            &["vertices of foot `left`", "[]"],
        ),
    ];
    for case in &cases {
        assert!(toml.contains(case.from), "nothing to spoil: {}", case.from);
        let spoilt = toml.replacen(case.from, case.to, 1);
        assert_says(robot_from_text(&spoilt, &urdf, "sparrow.toml"), case);
    }
}

#[test]
fn impossible_urdf_is_refused_by_name_and_value() {
    let (toml, urdf) = sparrow_texts();
    let cases = [
        // The tree.
        spoil("<robot", "<robt", &["sparrow.toml", "sparrow.urdf"]),
        spoil("<link name=\"head\">", "<link name=\"pack\">", &["URDF link `pack`", "more than once"]),
        spoil("<joint name=\"neck\"", "<joint name=\"waist\"", &["URDF joint `waist`", "more than once"]),
        spoil("<parent link=\"pelvis\"/>", "<parent link=\"hips\"/>", &["parent of joint `waist`", "`hips`"]),
        spoil("<child link=\"head\"/>", "<child link=\"skull\"/>", &["child of joint `neck`", "`skull`"]),
        spoil("<child link=\"head\"/>", "<child link=\"pack\"/>", &["link `pack`", "`neck`", "`pack_mount`"]),
        spoil("<child link=\"torso\"/>", "<child link=\"pelvis\"/>", &["root", "torso"]),
        spoil("<link name=\"head\">", "<link name=\"tail\"/><link name=\"head\">", &["root", "pelvis, tail"]),
        spoil(
            "<link name=\"torso\">",
            "<joint name=\"loop\" type=\"fixed\"><parent link=\"torso\"/><child link=\"pelvis\"/></joint><link name=\"torso\">",
            &["root", "cycle"],
        ),
        spoil(
            "<parent link=\"torso\"/>\n    <child link=\"pack\"/>",
            "<parent link=\"back_nozzle\"/>\n    <child link=\"pack\"/>",
            &["link `pack`", "cycle", "`pelvis`"],
        ),
        // What is missing, or no number.
        spoil("<child link=\"head\"/>", "", &["sparrow.urdf", "joint `neck` has no <child>"]),
        spoil("<child link=\"head\"/>", "<child/>", &["the <child> of joint `neck` has no `link`"]),
        spoil("<link name=\"head\">", "<link>", &["the <link> of robot `sparrow` has no `name`"]),
        spoil("<mass value=\"2.5\"/>", "", &["the <inertial> of link `pelvis` has no <mass>"]),
        spoil("ixx=\"0.010417\"", "", &["the <inertia> of link `pelvis` has no `ixx`"]),
        // What is there twice.
        spoil(
            "<mass value=\"2.5\"/>",
            "<mass value=\"2.5\"/><mass value=\"3\"/>",
            &["the <inertial> of link `pelvis` has more than one <mass>"],
        ),
        spoil(
            "<inertial>",
            "<inertial/><inertial>",
            &["sparrow.urdf", "link `pelvis` has more than one <inertial>"],
        ),
        spoil(
            "<axis xyz=\"0 0.8 0.6\"/>",
            "<axis xyz=\"0 0.8 0.6\"/><axis xyz=\"0 1 0\"/>",
            &["joint `l_shoulder` has more than one <axis>"],
        ),
        spoil(
            "upper=\"1.5\"",
            "upper=\"1.5 m\"",
            &["`upper` of the <limit> of joint `l_shoulder` is `1.5 m`", "a number"],
        ),
        spoil(
            "xyz=\"0 0.13 0.28\"",
            "xyz=\"0 0.13\"",
            &["`xyz` of the <origin> of joint `l_shoulder` is `0 0.13`", "3 numbers"],
        ),
        // Joints.
        spoil("\"l_hip\" type=\"revolute\"", "\"l_hip\" type=\"prismatic\"", &["joint `l_hip`", "prismatic"]),
        spoil("\"l_hip\" type=\"revolute\"", "\"l_hip\" type=\"floating\"", &["joint `l_hip`", "floating"]),
        spoil("\"l_hip\" type=\"revolute\"", "\"l_hip\" type=\"fixed\"", &["joint `l_hip`", "fixed"]),
        spoil("\"l_ankle\" type=\"fixed\"", "\"l_ankle\" type=\"revolute\"", &["joint `l_ankle`", "neither"]),
        spoil(
            "<axis xyz=\"0 0.8 -0.6\"/>",
            "<axis xyz=\"0 0.8 -0.6\"/><mimic joint=\"l_shoulder\"/>",
            &["sparrow.urdf", "joint `r_shoulder`", "mimic of `l_shoulder`", "`locked`"],
        ),
        spoil("<axis xyz=\"0 1 0\"/>", "<axis xyz=\"0 0 0\"/>", &["axis of joint `neck`", "a direction"]),
        spoil("upper=\"1.5\"", "upper=\"-1.2\"", &["limits_deg of joint `l_shoulder`", "range empty"]),
        spoil("lower=\"-1.2\"", "lower=\"nan\"", &["<limit> of joint `l_shoulder` is `nan`"]),
        spoil("effort=\"40\"", "effort=\"-40\"", &["effort limit of joint", "-40"]),
        spoil("xyz=\"0 0.13 0.28\"", "xyz=\"0 nan 0.28\"", &["`xyz`", "joint `l_shoulder` is `0 nan 0.28`"]),
        spoil("xyz=\"0 0.13 0.28\"", "xyz=\"0 1e300 0.28\"", &["joint `l_shoulder`", "up to 1e100"]),
        spoil("rpy=\"0.1 0 0\"", "rpy=\"inf 0 0\"", &["`rpy`", "joint `l_shoulder` is `inf 0 0`"]),
        // Masses.
        spoil("<mass value=\"2.5\"/>", "<mass value=\"0\"/>", &["mass of body `pelvis`", "positive"]),
        spoil(
            "<mass value=\"2.5\"/>",
            "<mass value=\"-2.5\"/>",
            &["sparrow.urdf", "mass of link `pelvis`", "-2.5"],
        ),
        spoil("<mass value=\"2.5\"/>", "<mass value=\"inf\"/>", &["<mass> of link `pelvis` is `inf`"]),
        spoil("ixx=\"0.010417\"", "ixx=\"nan\"", &["<inertia> of link `pelvis` is `nan`"]),
        spoil(
            "iyy=\"0.007417\"",
            "iyy=\"-0.007417\"",
            &["inertia of link `pelvis`", "-0.007417", "negative"],
        ),
        // More than the sum of the other two, along the axes and off them.
        spoil("izz=\"0.013667\"", "izz=\"0.017835\"", &["inertia of body `pelvis`", "0.017835", "sum"]),
        spoil("ixy=\"0\" ixz", "ixy=\"0.0075\" ixz", &["inertia of body `pelvis`", "sum"]),
        spoil("ixy=\"0\" ixz", "ixy=\"0.009\" ixz", &["inertia of link `pelvis`", "negative"]),
        spoil("xyz=\"0.005 0 0.17\"", "xyz=\"0.005 inf 0.17\"", &["<origin> of link `torso`", "inf"]),
    ];
    for case in &cases {
        assert!(urdf.contains(case.from), "nothing to spoil: {}", case.from);
        let spoilt = urdf.replacen(case.from, case.to, 1);
        assert_says(robot_from_text(&toml, &spoilt, "sparrow.toml"), case);
    }
}

/// Keys of a prismatic joint are not those of a revolute one, and the URDF states no limit by 0.
#[test]
fn limits_of_another_kind_or_without_a_value_are_refused() {
    let texts = |name: &str| {
        ["toml", "urdf"].map(|kind| std::fs::read_to_string(robot_file(&format!("{name}.{kind}"))).unwrap())
    };
    for case in [
        spoil(
            "limits = [-0.12, 0.15]",
            "limits_deg = [-10.0, 10.0]",
            &["limits_deg of joint `rail`", "prismatic"],
        ),
        spoil(
            "velocity_max_deg = 90.0",
            "velocity_max = 1.0",
            &["velocity_max of joint `hinge`", "revolute"],
        ),
        spoil("torque_max = 100.0", "torque_max = -1.0", &["torque_max` is -1.0"]),
        spoil(
            "hatch_rail = 0.04",
            "hatch_rail = 0.11",
            &["locked joint `hatch_rail` is 0.11", "from -0.1 to 0.1"],
        ),
        spoil("effort=\"80\"", "effort=\"0\"", &["slider.toml", "torque_max of joint `stroke`", "missing"]),
        spoil("type=\"prismatic\"", "type=\"planar\"", &["slider.urdf", "joint `rail`", "planar"]),
    ] {
        let [toml, urdf] = texts("slider").map(|text| text.replacen(case.from, case.to, 1));
        assert_ne!([toml.clone(), urdf.clone()], texts("slider"), "nothing to spoil: {}", case.from);
        assert_says(robot_from_text(&toml, &urdf, "slider.toml"), &case);
    }
}

#[test]
fn a_file_of_another_kind_is_refused() {
    let (toml, urdf) = sparrow_texts();
    let other = urdf.replace("<robot", "<sdf").replace("</robot>", "</sdf>");
    let message = robot_from_text(&toml, &other, "sparrow.toml").unwrap_err().to_string();
    assert!(message.contains("the outermost tag is <sdf>; expected <robot>"), "{message}");
}

/// Where such tags are read by a function that calls itself once a level, the process ends without stack.
#[test]
fn tags_that_nest_deeply_are_refused() {
    let (toml, urdf) = sparrow_texts();
    let nested = |depth| format!("{}{}</robot>", "<a>".repeat(depth), "</a>".repeat(depth));
    let load = |depth| robot_from_text(&toml, &urdf.replacen("</robot>", &nested(depth), 1), "sparrow.toml");
    assert!(load(63).is_ok());
    let message = load(20_000).unwrap_err().to_string();
    assert!(message.contains("sparrow.urdf: tags nest more than 64 deep"), "{message}");
}

/// A moving body needs mass and inertia, though a link of it may lack them.
#[test]
fn massless_and_point_like_bodies_are_refused() {
    let cases = [
        spoil("<mass value=\"2\"/>", "<mass value=\"0\"/>", &["mass of body `base`"]),
        spoil(
            "ixx=\"0.1\" ixy=\"0\" ixz=\"0\" iyy=\"0.2\" iyz=\"0\" izz=\"0.25\"",
            "ixx=\"0\" ixy=\"0\" ixz=\"0\" iyy=\"0\" iyz=\"0\" izz=\"0\"",
            &["inertia of body `base`", "[0.0, 0.0, 0.0]", "positive"],
        ),
    ];
    let alone = TWO_PARTS
        .replace("<child link=\"load\"/>", "<child link=\"frame\"/>")
        .split("<link name=\"load\">")
        .next()
        .unwrap()
        .to_owned()
        + "<link name=\"frame\"/></robot>";
    robot_from_text(NO_JOINTS, &alone, "alone").unwrap();
    for case in &cases {
        assert!(alone.contains(case.from));
        assert_says(robot_from_text(NO_JOINTS, &alone.replacen(case.from, case.to, 1), "alone"), case);
    }
    let empty = "<robot name='empty'><link name='base'/></robot>";
    let case = spoil("", empty, &["mass of body `base`", "is 0"]);
    assert_says(robot_from_text(NO_JOINTS, empty, "empty"), &case);

    // A point mass is fine where something else gives the body its inertia.
    let point = TWO_PARTS
        .replace("ixx=\"0.3\"", "ixx=\"0\"")
        .replace("iyy=\"0.4\"", "iyy=\"0\"")
        .replace("izz=\"0.5\"", "izz=\"0\"");
    robot_from_text(NO_JOINTS, &point, "point").unwrap();
}

/// Published figures are rounded: a flat plate may miss the triangle inequality in the sixth digit.
#[test]
fn rounded_flat_plate_is_accepted() {
    let alone = "<robot name='plate'><link name='base'><inertial><mass value='2'/>
        <inertia ixx='0.1' ixy='0' ixz='0' iyy='0.2' iyz='0' izz='IZZ'/></inertial></link></robot>";
    let plate = |izz: &str| robot_from_text(NO_JOINTS, &alone.replace("IZZ", izz), "plate");
    assert!(plate("0.3").is_ok());
    assert!(plate("0.3000002").is_ok());
    assert!(plate("0.30001").is_err());
}

#[test]
fn joint_listed_before_its_ancestor_is_refused() {
    let (toml, urdf) = sparrow_texts();
    let swapped = toml.replace("{ name = \"waist\", limits_deg = [-60.0, 60.0] },", "").replace(
        "{ name = \"r_shoulder\" },",
        "{ name = \"r_shoulder\" },\n{ name = \"waist\", limits_deg = [-60.0, 60.0] },",
    );
    assert_ne!(swapped, toml);
    let case = spoil("", "waist last", &["joint `l_shoulder`", "is 2", "`waist`", "at 4"]);
    assert_says(robot_from_text(&swapped, &urdf, "swapped"), &case);
}

#[test]
fn missing_files_are_named() {
    let error = load_robot(&robot_file("ostrich.toml")).unwrap_err();
    assert!(matches!(error, BuildError::Unreadable { .. }));
    assert!(error.to_string().contains("ostrich.toml"), "{error}");
}
