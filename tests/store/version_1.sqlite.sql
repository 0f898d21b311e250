BEGIN TRANSACTION;
CREATE TABLE budgets (
	result_id INTEGER NOT NULL, 
	quantity TEXT NOT NULL, 
	source TEXT NOT NULL, 
	std DOUBLE NOT NULL, 
	PRIMARY KEY (result_id, quantity, source), 
	FOREIGN KEY(result_id) REFERENCES results (id) ON DELETE CASCADE
);
INSERT INTO "budgets" VALUES(1,'s11','noise',3.0e-14);
INSERT INTO "budgets" VALUES(1,'s11','geometry',4.0e-14);
INSERT INTO "budgets" VALUES(1,'s11_tan','noise',0.0001);
INSERT INTO "budgets" VALUES(2,'s11','noise',3.0e-14);
INSERT INTO "budgets" VALUES(2,'s11','geometry',4.0e-14);
INSERT INTO "budgets" VALUES(2,'s11_tan','noise',0.0001);
CREATE TABLE causes (
	result_id INTEGER NOT NULL, 
	position INTEGER NOT NULL, 
	effect TEXT NOT NULL, 
	specimen TEXT, 
	probability DOUBLE NOT NULL, 
	parameters JSON NOT NULL, 
	PRIMARY KEY (result_id, position), 
	FOREIGN KEY(result_id) REFERENCES results (id) ON DELETE CASCADE
);
CREATE TABLE diagnoses (
	result_id INTEGER NOT NULL, 
	verdict TEXT NOT NULL, 
	PRIMARY KEY (result_id), 
	FOREIGN KEY(result_id) REFERENCES results (id) ON DELETE CASCADE
);
CREATE TABLE estimates (
	result_id INTEGER NOT NULL, 
	quantity TEXT NOT NULL, 
	value DOUBLE NOT NULL, 
	std DOUBLE, 
	PRIMARY KEY (result_id, quantity), 
	FOREIGN KEY(result_id) REFERENCES results (id) ON DELETE CASCADE
);
INSERT INTO "estimates" VALUES(1,'s11',1.65e-11,5.0e-14);
INSERT INTO "estimates" VALUES(1,'s11_tan',0.015,0.0001);
INSERT INTO "estimates" VALUES(1,'k_eff',0.35,NULL);
INSERT INTO "estimates" VALUES(2,'s11',1.65e-11,5.0e-14);
INSERT INTO "estimates" VALUES(2,'s11_tan',0.015,0.0001);
INSERT INTO "estimates" VALUES(2,'k_eff',0.35,NULL);
CREATE TABLE femu_piezo_version (
	version_num VARCHAR(32) NOT NULL, 
	CONSTRAINT femu_piezo_version_pkc PRIMARY KEY (version_num)
);
INSERT INTO "femu_piezo_version" VALUES('1');
CREATE TABLE inputs (
	result_id INTEGER NOT NULL, 
	position INTEGER NOT NULL, 
	specimen_id INTEGER NOT NULL, 
	sweep_id INTEGER, 
	PRIMARY KEY (result_id, position), 
	FOREIGN KEY(result_id) REFERENCES results (id) ON DELETE CASCADE, 
	FOREIGN KEY(specimen_id) REFERENCES specimens (id), 
	FOREIGN KEY(sweep_id) REFERENCES sweeps (id)
);
INSERT INTO "inputs" VALUES(1,0,1,1);
INSERT INTO "inputs" VALUES(2,0,1,2);
CREATE TABLE lots (
	id INTEGER NOT NULL, 
	name TEXT NOT NULL, 
	PRIMARY KEY (id), 
	UNIQUE (name)
);
INSERT INTO "lots" VALUES(1,'old');
CREATE TABLE results (
	id INTEGER NOT NULL, 
	piece VARCHAR(64) NOT NULL, 
	assumed VARCHAR(64) NOT NULL, 
	step TEXT NOT NULL, 
	program TEXT NOT NULL, 
	lot_id INTEGER, 
	name TEXT NOT NULL, 
	status TEXT NOT NULL, 
	reason TEXT NOT NULL, 
	written DATETIME NOT NULL, 
	columns JSON NOT NULL, 
	record JSON, 
	PRIMARY KEY (id), 
	UNIQUE (piece, assumed, step, program), 
	FOREIGN KEY(lot_id) REFERENCES lots (id)
);
INSERT INTO "results" VALUES(1,'8456dd199ce601ecff88dccf6b486bf4090bcf896525885c3157dd05ea9ce835','5adb8c3d42601f14dc3c467830d23dcc75ffae17236d02c6bb26c6e31b1c3c8e','update','0.1.0+old',1,'p1.csv','ok','','2026-01-05 08:00:00.000000','{"s11": 1.65e-11, "s11_std": 5e-14, "s11_tan": 0.015, "s11_tan_std": 0.0001, "k_eff": 0.35}','{"parameters": {"s11": {"value": 1.65e-11, "std": 5e-14, "tan": 0.015, "tan_std": 0.0001, "budget": {"noise": 3e-14, "geometry": 4e-14}, "tan_budget": {"noise": 0.0001}}}, "causes": []}');
INSERT INTO "results" VALUES(2,'26e2cf3ad9b36185a672551c930c05074396613046203ecbc8e21536be64ee28','5adb8c3d42601f14dc3c467830d23dcc75ffae17236d02c6bb26c6e31b1c3c8e','update','0.1.0+old',1,'p2.csv','ok','','2026-01-05 08:00:00.000000','{"s11": 1.65e-11, "s11_std": 5e-14, "s11_tan": 0.015, "s11_tan_std": 0.0001, "k_eff": 0.35}','{"parameters": {"s11": {"value": 1.65e-11, "std": 5e-14, "tan": 0.015, "tan_std": 0.0001, "budget": {"noise": 3e-14, "geometry": 4e-14}, "tan_budget": {"noise": 0.0001}}}, "causes": []}');
CREATE TABLE specimens (
	id INTEGER NOT NULL, 
	hash VARCHAR(64) NOT NULL, 
	name TEXT NOT NULL, 
	description JSON, 
	PRIMARY KEY (id), 
	UNIQUE (hash)
);
INSERT INTO "specimens" VALUES(1,'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa','plate','{"name": "plate", "geometry": {"shape": "plate"}}');
CREATE TABLE sweeps (
	id INTEGER NOT NULL, 
	hash VARCHAR(64) NOT NULL, 
	file TEXT NOT NULL, 
	measured DATETIME NOT NULL, 
	PRIMARY KEY (id), 
	UNIQUE (hash)
);
INSERT INTO "sweeps" VALUES(1,'aca2a6a484b2fddc12ddff94523e93fe616ee576f5240d26c7cf86574583ee5e','p1.csv','2026-01-05 08:00:00.000000');
INSERT INTO "sweeps" VALUES(2,'1e6029c1ab54ea43e092313074f888e8b342761024d0be16c3cf4e98e5b733e9','p2.csv','2026-01-05 08:00:00.000000');
COMMIT;
